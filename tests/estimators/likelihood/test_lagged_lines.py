"""A measured pressure whose corners an I/P has rounded is told by its lines and its lag."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.likelihood.inputs.pressure_lines import MeasuredPath, measured_path
from estimators.likelihood.lines.joined_pieces import Joint
from estimators.likelihood.lines.lagged_lines import LaggedLines, lagged_lines, lines_behind_some_lag
from estimators.likelihood.lines.pieces import fit_pieces
from estimators.samples import FloatArray
from simulator import transducer
from tests.estimators.random_valves import random_test
from valve.waveform import Waveform, multi_rate_triangle, sine, steps, triangle

LOW_PA, HIGH_PA = 20.0e3, 100.0e3
SPAN_PA = HIGH_PA - LOW_PA
NOISE_PA = 1.0e-3 * SPAN_PA
WAVES = {
    "triangle": triangle(20.0, 3, LOW_PA, HIGH_PA),
    "multi_rate": multi_rate_triangle([20.0, *[2.0] * 8], LOW_PA, HIGH_PA),
    "steps": steps([LOW_PA, 50.0e3, HIGH_PA, 70.0e3, LOW_PA], 8.0),
}
EVENTS = {"triangle": 5, "multi_rate": 17, "steps": 4}


def measured(wave: Waveform, lag_s: float, period_s: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, true pressure and measured pressure."""
    at_s, pressure_pa = transducer.lagged(wave.time_s, wave.pressure_pa, float(wave.pressure_pa[0]), lag_s)
    time_s = np.arange(round(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    true_pa = np.interp(time_s, at_s, pressure_pa)
    return time_s, true_pa, true_pa + NOISE_PA * np.random.default_rng(seed).standard_normal(time_s.size)


def found(time_s: FloatArray, measured_pa: FloatArray) -> LaggedLines:
    fit = lagged_lines(time_s, measured_pa, NOISE_PA)
    assert fit is not None
    return fit


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize(("lag_s", "period_s"), [(0.1, 1.0e-3), (0.93, 1.0e-3), (0.1, 0.01), (0.3, 0.01)])
def test_the_pressure_is_known_as_well_as_that_of_so_many_sharp_lines(name: str, lag_s: float, period_s: float) -> None:
    time_s, true_pa, measured_pa = measured(WAVES[name], lag_s, period_s, seed=3)
    fit = found(time_s, measured_pa)
    assert fit.steps.size == EVENTS[name]
    assert bool(fit.steps.all()) == (name == "steps")
    off_pa = np.interp(time_s, *fit.corners()) - true_pa
    assert float(np.sqrt(np.mean(off_pa**2))) < 1.6 * NOISE_PA * np.sqrt(fit.parameters.size / time_s.size)


def test_lag_and_pressure_lie_within_their_errors() -> None:
    lags, squares = [], []
    for seed in range(30):
        time_s, true_pa, measured_pa = measured(WAVES["triangle"], 0.3, 0.01, seed)
        fit = found(time_s, measured_pa)
        lags.append((fit.lag_s - 0.3) / float(np.linalg.norm(fit.root[:, 3])))
        plain = np.interp(time_s[50::97], *fit.corners())
        variance = sum((np.interp(time_s[50::97], *fit.corners(i)) - plain) ** 2 for i in range(fit.directions))
        squares.append(np.mean((plain - true_pa[50::97]) ** 2 / variance))
    assert float(np.std(lags)) == pytest.approx(1.0, abs=0.35)
    assert abs(float(np.mean(lags))) < 0.55
    assert float(np.mean(squares)) == pytest.approx(1.0, abs=0.3)


def test_what_no_lag_has_made_is_left_to_free_curves() -> None:
    wave = sine(8.0, 3, LOW_PA, HIGH_PA)
    time_s = np.arange(2401, dtype=np.float64) * 0.01
    measured_pa = wave.at(time_s) + NOISE_PA * np.random.default_rng(1).standard_normal(2401)
    assert lagged_lines(time_s, measured_pa, NOISE_PA) is None


def test_two_lags_in_a_row_are_not_taken_for_one() -> None:
    wave = WAVES["triangle"]
    at_s, once_pa = transducer.lagged(wave.time_s, wave.pressure_pa, LOW_PA, 0.6)
    twice_s, twice_pa = transducer.lagged(at_s, once_pa, LOW_PA, 0.6)
    time_s = np.arange(60_001, dtype=np.float64) * 1.0e-3
    measured_pa = np.interp(time_s, twice_s, twice_pa) + NOISE_PA * np.random.default_rng(1).standard_normal(60_001)
    fit = lagged_lines(time_s, measured_pa, NOISE_PA)
    off_pa = 0.0 if fit is None else float(np.abs(np.interp(time_s, *fit.corners()) - measured_pa).max())
    assert fit is None or off_pa < 6.0 * NOISE_PA


def test_a_hold_of_a_few_rows_meets_its_ramp_at_a_corner() -> None:
    # 0.15 s at 50 ms: the slope of three rows is hardly known; taken for a smooth passage, lag and swing explained it
    wave = WAVES["triangle"]
    time_s = np.arange(1200, dtype=np.float64) * 0.05
    true_pa = np.interp(time_s, 0.157 + wave.time_s, wave.pressure_pa)
    for seed in range(20):
        measured_pa = true_pa + NOISE_PA * np.random.default_rng(seed).standard_normal(time_s.size)
        assert (fit_pieces(time_s, measured_pa, NOISE_PA).joint == Joint.CORNER).all(), seed


def test_a_lag_that_is_no_longer_than_its_error_is_none() -> None:
    wave = WAVES["triangle"]
    time_s = np.arange(6000, dtype=np.float64) * 0.01
    true_pa = np.interp(time_s, wave.time_s, wave.pressure_pa)
    for seed in range(4):
        measured_pa = true_pa + NOISE_PA * np.random.default_rng(seed).standard_normal(time_s.size)
        assert lagged_lines(time_s, measured_pa, NOISE_PA) is None, seed


@pytest.mark.parametrize(("name", "lag_s", "period_s"), [("multi_rate", 0.07, 1.0e-3), ("triangle", 0.02, 5.0e-3)])
def test_a_lag_is_found_between_the_turns_of_a_signal(name: str, lag_s: float, period_s: float) -> None:
    wave = WAVES[name]
    held = Waveform(name, np.concatenate([[0.0], 0.5 + wave.time_s]), np.concatenate([[LOW_PA], wave.pressure_pa]))
    time_s, true_pa, measured_pa = measured(held, lag_s, period_s, seed=5)
    fit = lines_behind_some_lag(time_s, measured_pa, NOISE_PA)
    assert fit is not None
    assert fit.steps.size == EVENTS[name] + 1
    assert fit.lag_s == pytest.approx(lag_s, abs=5.0 * float(np.linalg.norm(fit.root[:, 3])))
    off_pa = np.interp(time_s, *fit.corners()) - true_pa
    assert float(np.sqrt(np.mean(off_pa**2))) < 1.6 * NOISE_PA * np.sqrt(fit.parameters.size / time_s.size)


def test_sharp_corners_and_a_signal_that_stands_still_have_no_lag() -> None:
    time_s, _true_pa, measured_pa = measured(WAVES["triangle"], 0.0, 1.0e-3, seed=6)
    assert lines_behind_some_lag(time_s, measured_pa, NOISE_PA) is None
    still_pa = LOW_PA + NOISE_PA * np.random.default_rng(7).standard_normal(time_s.size)
    assert lines_behind_some_lag(time_s, still_pa, NOISE_PA) is None


def test_a_corner_that_a_short_lag_rounds_is_drawn_behind_its_lag() -> None:
    test = random_test(4245)  # 80 ms behind 0.1 % of noise at 5 ms: two straight corners hid it
    path = measured_path(test.recording, test.recording.actuator_force_n(test.nameplate))
    assert isinstance(path, MeasuredPath)
    (lines,) = path.stretches
    assert isinstance(lines, LaggedLines)
    assert lines.lag_s == pytest.approx(test.lag_s, rel=0.15)
