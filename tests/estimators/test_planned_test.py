"""The bound of a planned test: against a fit of noisy positions, and what sequence, lag and sampling do to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.identifiability.sensitivities import position_sensitivities
from estimators.motion.channels import ONE_INSTANT
from estimators.planned_test import PlannedTest, planned_knowledge
from valve.errors import WaveformError
from valve.motion import simulate_motion
from valve.parameter_sets import parameter_set
from valve.waveform import Waveform, multi_rate_periods, multi_rate_triangle, steps, triangle

AREA_M2 = 0.06452
NOISE_M = 20.0e-6
TRIANGLE = triangle(20.0, 3, 0.0, 82737.0)
MULTI_RATE = multi_rate_triangle(multi_rate_periods(3.0), 0.0, 82737.0)


def planned(
    waveform: Waveform, *, period_s: float = 1.0e-3, lag_s: float = 0.0, pressure_measured: bool = True
) -> PlannedTest:
    return PlannedTest(waveform, AREA_M2, period_s, NOISE_M, lag_s, pressure_measured)


def test_a_linear_fit_of_noisy_positions_scatters_as_the_bound_says() -> None:
    parameters = parameter_set("nominal").parameters
    test = planned(MULTI_RATE, period_s=0.02)
    known = planned_knowledge(parameters, test)
    time_s = test.output_times_s
    _, slopes = position_sensitivities(parameters, *test.corners(0.0), time_s, known.symbols[:-1])
    sides = [simulate_motion(parameters, *test.corners(0.0), time_s + late_s).position_m for late_s in (1e-6, -1e-6)]
    slopes = np.column_stack([slopes, (sides[1] - sides[0]) / 2.0e-6])
    size = np.linalg.norm(slopes, axis=0)
    # what is known beforehand of DV and of the delay, as two more rows
    rows = np.zeros((2, size.size))
    sds = np.array([1.5 * parameters.limit_velocity_m_per_s, 0.01])
    rows[[0, 1], [known.symbols.index("DV"), known.symbols.index("delay_s")]] = NOISE_M / sds
    matrix = np.vstack([slopes, rows]) / size
    noise_m = NOISE_M * np.random.default_rng(1).standard_normal((matrix.shape[0], 400))
    fitted = np.linalg.lstsq(matrix, noise_m, rcond=None)[0] / size[:, None]
    for row, symbol in enumerate(known.symbols):
        assert fitted[row].std() == pytest.approx(known.std_error(symbol), rel=0.15), symbol


@pytest.mark.parametrize(("name", "period_s"), [("nominal", 1.0e-3), ("rough", 0.02), ("vendor", 0.05)])
def test_many_rates_tell_more_than_the_triangle_in_the_same_minute(name: str, period_s: float) -> None:
    parameters = parameter_set(name).parameters
    one = planned_knowledge(parameters, planned(TRIANGLE, period_s=period_s))
    many = planned_knowledge(parameters, planned(MULTI_RATE, period_s=period_s))
    assert MULTI_RATE.duration_s <= TRIANGLE.duration_s
    for symbol in ("m", "F_v"):
        assert many.relative(symbol) < 0.6 * one.relative(symbol)
    assert many.relative("DV") < 1.001 * one.relative("DV")


def test_without_a_measured_pressure_the_lag_is_one_of_the_unknown() -> None:
    parameters = parameter_set("graphite").parameters
    test = PlannedTest(triangle(20.0, 3, 42231.0, 206322.0), 0.0445, 0.02, NOISE_M, 0.3, pressure_measured=False)
    known = planned_knowledge(parameters, test)
    assert known.symbols[-2:] == ("transducer_dead_time_s", "transducer_lag_s")
    tie = known.ties("F_c")
    assert tie is not None
    assert tie.symbols == ("F_c", "transducer_lag_s")
    assert "measure the pressure" in tie.separated_by
    measured = planned_knowledge(parameters, PlannedTest(test.waveform, 0.0445, 0.02, NOISE_M, 0.3))
    assert measured.relative("F_c") < 0.1 * known.relative("F_c")


def test_bound_scales_with_the_noise() -> None:
    parameters = parameter_set("rough").parameters
    once = planned_knowledge(parameters, planned(MULTI_RATE))
    twice = planned_knowledge(parameters, PlannedTest(MULTI_RATE, AREA_M2, 1.0e-3, 2.0 * NOISE_M))
    for symbol in ("k", "F_c"):
        assert twice.std_error(symbol) == pytest.approx(2.0 * once.std_error(symbol), rel=0.02)


def test_rates_of_the_force_are_those_of_the_ramps() -> None:
    assert planned(TRIANGLE).force_rates_n_per_s == pytest.approx((AREA_M2 * 8273.7,))
    assert len(planned(MULTI_RATE).force_rates_n_per_s) == len(multi_rate_periods(3.0))
    assert planned(steps([0.0, 4.0e4], 5.0)).force_rates_n_per_s == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"period_s": 0.0}, "period_s is 0"),
        ({"lag_s": -1.0}, "lag is -1"),
        ({"pressure_measured": False}, "nor 0 where the pressure is not measured"),
    ],
)
def test_a_test_that_cannot_be_is_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(WaveformError, match=words):
        planned(TRIANGLE, **change)  # type: ignore[arg-type]  # the point of the test


def test_where_a_device_captures_both_channels_at_once_damping_and_mass_are_told_more_narrowly() -> None:
    parameters = parameter_set("vendor").parameters
    polled = planned(MULTI_RATE)
    at_once = replace(polled, delay_periods=ONE_INSTANT)
    apart, together = planned_knowledge(parameters, polled), planned_knowledge(parameters, at_once)
    assert together.relative("m") < 0.5 * apart.relative("m")
    assert together.relative("F_v") < 0.3 * apart.relative("F_v")
    assert together.relative("k") == pytest.approx(apart.relative("k"), rel=0.2)
    with pytest.raises(WaveformError, match="delay_periods"):
        replace(polled, delay_periods=0.0)
