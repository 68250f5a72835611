"""The rows of the balance of forces: each is of a stem that is driven and has settled."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from discrepancy.rough.observations import observations
from estimators.base import Outcome
from estimators.engine.balance import Blocks, Swept, balance, driven_blocks
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading, read
from estimators.engine.roughness import EDGED, ROUGH, SMOOTH, field_covariance, field_slopes, roughness_of
from tests.support.published_recordings import followed
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import ValveParameters
from valve.recording import Recording
from valve.waveform import Waveform

_NOISE_M = 5.0e-6
_OFF = 0.05  # of F_c: what noise and the last of a transient leave of a row


@cache
def _late_stem() -> tuple[Reading, ValveParameters]:
    """A stem half a second late behind ramps that wait a while, three times one way and three times back."""
    published = parameter_set("graphite")
    parameters = replace(
        published.parameters,
        viscous_friction_n_s_per_m=0.5 * published.parameters.spring_rate_n_per_m,
        limit_velocity_m_per_s=5.0e-5,
    )
    assert published.nameplate.signal is not None
    low, high = published.nameplate.signal.range_pa
    legs = [(2.5, 0.4), (1.0, 0.4), (0.5, 0.55), (1.2, 0.55), (0.5, 0.7), (1.0, 0.7), (3.0, 1.0)]
    legs += [(2.5, 0.6), (1.0, 0.6), (0.5, 0.45), (1.2, 0.45), (0.5, 0.3), (1.0, 0.3), (3.0, 0.0)]
    time_s, share = np.cumsum([0.0, *[leg_s for leg_s, _ in legs]]), np.array([0.0, *[to for _, to in legs]])
    return _read_of(parameters, published.nameplate, Waveform("waits", time_s, low + share * (high - low)))


def _read_of(parameters: ValveParameters, nameplate: Nameplate, wave: Waveform) -> tuple[Reading, ValveParameters]:
    area_m2 = nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    time_s = np.arange(round(wave.duration_s / 1.0e-3) + 1, dtype=np.float64) * 1.0e-3
    position_m = followed(parameters, wave, area_m2, time_s, None)
    position_m = position_m + _NOISE_M * np.random.default_rng(3).standard_normal(time_s.size)
    reading = read(Recording(time_s, position_m, pressure_pa=wave.at(time_s)), nameplate)
    assert not isinstance(reading, Outcome)
    return reading, parameters


def _farthest_off(
    p: ValveParameters,
    travel_m: npt.NDArray[np.float64],
    force_n: npt.NDArray[np.float64],
    rate_n_per_s: npt.NDArray[np.float64],
    direction: npt.NDArray[np.float64],
) -> float:
    """By how much of F_c the worst row is off the balance of a stem that has settled behind its ramp."""
    lag_s = p.viscous_friction_n_s_per_m / p.spring_rate_n_per_m
    known_n = p.preload_n + p.spring_rate_n_per_m * travel_m + direction * p.coulomb_friction_n + lag_s * rate_n_per_s
    return float(np.abs(force_n - known_n).max()) / p.coulomb_friction_n


@pytest.mark.parametrize("lag_s", [0.22, 0.28])
def test_no_row_is_of_a_stem_that_has_not_settled_since_its_force_waited(lag_s: float) -> None:
    reading, p = _late_stem()
    blocks = driven_blocks(reading, Known(lag_s, 0.2))
    rows = observations(reading, Known(lag_s, 0.2))
    rows = rows.rows(rows.is_slide)
    assert min(blocks.count, rows.count) >= 6
    for one in (blocks, rows):
        assert _farthest_off(p, one.travel_m, one.force_n, one.rate_n_per_s, one.direction) < _OFF


def _half_seen(seed: int) -> tuple[Known, float]:
    """F_c of a rough stem whose blocks on the way back cover half of what it swept, and its true average."""
    random = np.random.default_rng(seed)
    travel_m, spring, friction_n, rough_n = 0.1, 5.0e4, 1500.0, 25.0
    everywhere_m = np.linspace(0.1, 0.9, 400) * travel_m

    def drawn() -> npt.NDArray[np.float64]:
        centres_m, heights = random.uniform(0.0, travel_m, 60), random.standard_normal(60)
        bumps = np.exp(-(((everywhere_m[:, None] - centres_m) / (0.04 * travel_m)) ** 2)) @ heights
        return np.asarray(rough_n * bumps / bumps.std())

    varies = {1.0: drawn(), -1.0: drawn()}
    parts = []
    for rate in (500.0, 2000.0, 4000.0):
        for way, (low, high) in ((1.0, (0.15, 0.9)), (-1.0, (0.4, 0.75))):
            at_m = np.arange(low, high, 0.008)[:: int(way)] * travel_m
            force_n = (
                way * (friction_n + np.interp(at_m, everywhere_m, varies[way])) + spring * at_m + 0.01 * way * rate
            )
            parts.append(np.stack([at_m, np.full(at_m.size, way * rate), force_n, np.full(at_m.size, way)]))
    at_m, rate_n_per_s, force_n, direction = np.concatenate(parts, axis=1)
    time_s, ones = 0.1 * np.arange(at_m.size), np.ones(at_m.size)
    found = balance(
        Blocks(time_s, at_m, rate_n_per_s, force_n, direction, ones, 0.1 * ones),
        noise_m=1.0e-5,
        travel_m=travel_m,
        has_spring=True,
        force_noise_n=1.0,
        lag=Known(0.01, 0.02),
        over=Swept(0.1 * travel_m, 0.9 * travel_m, 0.0, 0.1 * at_m.size),
    )
    assert found is not None
    return found.over_travel("F_c"), friction_n + 0.5 * float(varies[1.0].mean() + varies[-1.0].mean())


def test_friction_is_as_unsure_as_it_varies_where_the_stem_slipped_over_it() -> None:
    # averaged over the blocks alone it was off by four standard errors, rms
    off = [(known.value - truth) / known.std_error for known, truth in map(_half_seen, range(12))]
    assert float(np.sqrt(np.mean(np.square(off)))) < 2.0


@pytest.mark.parametrize("smoothness", [ROUGH, EDGED, SMOOTH])
def test_the_weighed_slopes_are_those_of_the_covariance(smoothness: int) -> None:
    draw = np.random.default_rng(3)
    places = draw.uniform(0.0, 0.1, 30), np.sort(draw.uniform(0.0, 60.0, 30)), np.repeat([1.0, -1.0], 15)
    root = draw.normal(size=(30, 30))
    weight = root @ root.T
    logarithms = np.log([12.0, 7.0, 0.02, 5.0, 9.0, 1.0])
    found = field_slopes(*places, roughness_of(logarithms), smoothness, weight=weight)
    for number in range(5):
        step = 1.0e-5 * np.eye(6)[number]
        sides = [field_covariance(*places, roughness_of(logarithms + sign * step), smoothness) for sign in (1.0, -1.0)]
        assert found[number] == pytest.approx(np.sum(weight * (sides[0] - sides[1])) / 2.0e-5, rel=1.0e-6)
