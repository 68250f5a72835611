"""What noise and slow sampling hide is said to be hidden, and what is given keeps its interval."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.base import Estimate, Estimator, Form, Outcome, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.samples import channel_noise
from tests.support.published_recordings import VALVES, Recorded, paper_triangle, recorded
from tests.support.random_valves import random_test
from valve.motion import simulate_motion
from valve.parameter_sets import parameter_set
from valve.recording import Recording
from valve.waveform import Waveform, multi_rate_triangle, triangle

BOTH: list[Estimator] = [RegressionEstimator(), GarciaEstimator()]
# Those that take differences.
CORRECTED: list[Estimator] = [RegressionEstimator(form=Form.CORRECTED), GarciaEstimator(form=Form.CORRECTED)]
DIFFERENCING: list[Estimator] = [
    *CORRECTED,
    RegressionEstimator(form=Form.PUBLISHED),
    GarciaEstimator(form=Form.PUBLISHED),
]


def by_form(estimator: Estimator) -> str:
    return f"{estimator.method}-{getattr(estimator, 'form', '')}"


def estimated(estimator: Estimator, test: Recorded) -> Estimate:
    return estimator.estimate(test.recording, test.nameplate)


@pytest.mark.parametrize("estimator", DIFFERENCING, ids=by_form)
@pytest.mark.parametrize("name", VALVES)
def test_differences_never_give_a_mass_at_20_um_and_1_ms(name: str, estimator: Estimator) -> None:
    estimate = estimated(estimator, recorded(name, noise_m=20.0e-6))
    assert estimate.value("m") is None
    assert estimate.parameters["m"].note


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
@pytest.mark.parametrize("name", ["nominal", "rough"])
def test_friction_and_spring_are_known_at_20_um(name: str, estimator: Estimator) -> None:
    test = recorded(name, noise_m=20.0e-6)
    estimate = estimated(estimator, test)
    for symbol, rel in (("k", 2.0e-4), ("F_c", 2.0e-3), ("F_s", 1.5e-3)):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=rel), symbol
    assert estimate.residual_rms_m == pytest.approx(20.0e-6, rel=1.0)


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_form)
@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6])
def test_polled_at_20_hz_differences_give_neither_m_nor_f_v_of_the_nominal_valve(
    estimator: Estimator, noise_m: float
) -> None:
    test = recorded("nominal", period_s=0.05, noise_m=noise_m, jitter=0.1)
    estimate = estimated(estimator, test)
    assert estimate.status is Status.OK  # friction and spring are given, with intervals that are meant to hold
    assert "sampling rate is too low" in estimate.message
    for symbol in ("m", "F_v"):
        assert not estimate.parameters[symbol].identifiable
        assert estimate.value(symbol) is None
        assert "sampling rate" in estimate.parameters[symbol].note
    for symbol, rel in (("k", 1.0e-3), ("F_c", 0.01), ("F_s", 0.01)):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=rel), symbol
    assert re.search(r"F_c \+ 0\.010(2|16\d*) m/s \* F_v = 14[23]\d", estimate.parameters["F_c"].note)


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
def test_a_transient_shorter_than_five_samples_gives_no_mass_even_without_noise(estimator: Estimator) -> None:
    for period_s, resolved in ((1.0e-3, True), (5.0e-3, False)):
        mass = estimated(estimator, recorded("nominal", period_s=period_s)).parameters["m"]
        assert mass.identifiable is resolved
        assert resolved or "sampling rate is too low" in mass.note


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_form)
def test_without_a_slip_jump_f_c_is_said_to_be_tied_to_f_v(estimator: Estimator) -> None:
    estimate = estimated(estimator, recorded("vendor", noise_m=20.0e-6))
    assert estimate.value("F_c") is None
    assert "tied to F_v" in estimate.parameters["F_c"].note
    clean = estimated(estimator, recorded("vendor"))
    assert "without a slip jump" in clean.parameters["F_c"].note


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
def test_gaps_are_never_differenced_across(estimator: Estimator) -> None:
    test = recorded("nominal")
    position_m = test.recording.position_m.copy()
    random = np.random.default_rng(7)
    for first in random.integers(0, position_m.size, 30):
        position_m[first : first + int(random.integers(1, 200))] = np.nan
    speed = np.abs(np.diff(test.recording.position_m))
    for slip in np.flatnonzero((speed[1:] > 5.0e-5) & (speed[:-1] <= 5.0e-5)):
        position_m[slip + 8 : slip + 14] = np.nan  # in the midst of each slip
    missing = np.isnan(position_m)
    with_gaps = Recording(time_s=test.recording.time_s, position_m=position_m, pressure_pa=test.recording.pressure_pa)
    for recording in (with_gaps, test.recording.rows(~missing)):
        estimate = estimated(estimator, Recorded(recording, test.nameplate, test.truth))
        for symbol in ("m", "k", "F_v", "F_c"):
            assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=1.0e-4), symbol


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_form)
@pytest.mark.parametrize("name", ["nominal", "rough"])
def test_a_16_bit_position_still_gives_the_mass(name: str, estimator: Estimator) -> None:
    test = recorded(name, resolution_m=0.1016 / 65535)
    estimate = estimated(estimator, test)
    assert estimate.value("m") == pytest.approx(test.truth.mass_kg, rel=0.06)


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
@pytest.mark.parametrize(
    ("name", "period_s", "noise_m"),
    [("nominal", 1e-3, 1e-6), ("rough", 1e-3, 5e-6), ("vendor", 1e-3, 20e-6), ("graphite", 1e-2, 10e-6)],
)
def test_errors_keep_to_the_standard_errors(name: str, period_s: float, noise_m: float, estimator: Estimator) -> None:
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    scores = []
    for seed in range(6):
        wave = triangle(20.0 + 0.07 * seed, 3, *signal.range_pa)
        test = recorded(name, period_s=period_s, noise_m=noise_m, seed=seed, waveform=wave)
        estimate = estimated(estimator, test)
        for symbol, parameter in estimate.parameters.items():
            if parameter.value is not None and parameter.std_error:
                scores.append((parameter.value - test.truth.by_symbol()[symbol]) / parameter.std_error)
    assert len(scores) >= 12
    assert float(np.sqrt(np.mean(np.square(scores)))) < 2.0
    assert float(np.abs(scores).max()) < 6.0


def lagged_recording(
    name: str, *, period_s: float, lag_s: float, noise_pa: float, measured: bool, wave: Waveform | None = None
) -> Recorded:
    """A valve behind a lagging transducer; its pressure measured with noise, or only its command known."""
    chosen = parameter_set(name)
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    wave = paper_triangle(name) if wave is None else wave
    fine_s = np.arange(0.0, wave.duration_s + 0.5e-3, 1.0e-3)
    command_pa = wave.at(fine_s)
    kept = math.exp(-1.0e-3 / lag_s)
    pressure_pa = lfilter([1.0 - kept], [1.0, -kept], command_pa, zi=[kept * command_pa[0]])[0]
    random = np.random.default_rng(12)
    time_s = np.arange(0.0, wave.duration_s, period_s)
    position_m = simulate_motion(chosen.parameters, fine_s, area_m2 * pressure_pa, time_s).position_m
    position_m = np.round((position_m + 5.0e-6 * random.standard_normal(time_s.size)) / 1.5e-6) * 1.5e-6
    seen_pa = np.interp(time_s, fine_s, pressure_pa) + noise_pa * random.standard_normal(time_s.size)
    channel = {"pressure_pa": seen_pa} if measured else {"command_pa": np.interp(time_s, fine_s, command_pa)}
    return Recorded(Recording(time_s=time_s, position_m=position_m, **channel), chosen.nameplate, chosen.parameters)


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
@pytest.mark.parametrize(
    ("name", "period_s"), [("vendor", 0.02), ("nominal", 0.02), ("nominal", 1e-3), ("graphite", 1e-3)]
)
def test_a_lagging_transducer_with_a_noisy_pressure_does_no_harm(
    name: str, period_s: float, estimator: Estimator
) -> None:
    test = lagged_recording(name, period_s=period_s, lag_s=0.1, noise_pa=20.0, measured=True)
    estimate = estimated(estimator, test)
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=5.0e-4)
    for symbol in ("F_c", "F_s"):
        parameter = estimate.parameters[symbol]
        if parameter.ci95 is not None:
            assert parameter.value is not None
            assert parameter.std_error is not None
            assert abs(parameter.value - test.truth.by_symbol()[symbol]) < 4.0 * parameter.std_error, symbol


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
def test_a_command_in_place_of_the_pressure_is_said_to_add_its_lag(estimator: Estimator) -> None:
    test = lagged_recording("nominal", period_s=1.0e-3, lag_s=0.1, noise_pa=0.0, measured=False)
    estimate = estimated(estimator, test)
    assert estimate.status is Status.POOR
    assert str(Outcome.COMMAND_ONLY) in estimate.message
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=5.0e-4)
    for symbol in ("F_c", "F_s"):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol] + 53.4, abs=8.0)
        assert estimate.parameters[symbol].ci95 is None
        assert "lag" in estimate.parameters[symbol].note


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
def test_a_commands_breakaways_that_scatter_by_its_lag_give_no_static_friction(estimator: Estimator) -> None:
    """At two rates the lag adds two forces: F_s was 39 % too large, without an interval."""
    wave = multi_rate_triangle([20.0, 8.0, 4.0, 2.5, 2.5], 0.0, 82737.0)
    test = lagged_recording("nominal", period_s=20.0e-3, lag_s=0.25, noise_pa=0.0, measured=False, wave=wave)
    entry = estimated(estimator, test).parameters["F_s"]
    assert entry.value is None
    assert "measure the pressure" in entry.note


@pytest.mark.parametrize("estimator", BOTH, ids=by_form)
def test_a_command_alone_gives_no_static_friction_of_a_stem_without_a_slip_jump(estimator: Estimator) -> None:
    # a breakaway late by lag and dead time: F_s was 54 times the true one
    test = random_test(2064)
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is not Status.OK
    assert estimate.value("F_s") is None
    assert estimate.parameters["F_s"].note


def test_noise_is_measured_also_where_samples_are_uneven() -> None:
    random = np.random.default_rng(3)
    for jitter in (0.0, 0.2):
        time_s = 0.01 * (np.arange(4000) + jitter * random.uniform(-1.0, 1.0, 4000))
        ramp_m = 0.02 * time_s + 20.0e-6 * random.standard_normal(4000)
        noise_m = channel_noise(time_s, ramp_m, np.zeros(4000, dtype=np.int64))
        assert noise_m == pytest.approx(20.0e-6, rel=0.05)
