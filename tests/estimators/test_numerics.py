"""The parts that both methods are made of, against plain computations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from estimators.base import Outcome
from estimators.classic.differences import backward_differences, noise_covariance, without_bias, without_bias_massless
from estimators.classic.threshold_sweep import sweep_thresholds
from estimators.linear_fit import fit_linear, fit_trimmed, inverse_of
from estimators.motion.phases import find_phases
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.motion.windowed_slope import windowed_slope, windowed_slope_noise
from estimators.samples import FloatArray, Samples, prepare
from tests.support.published_recordings import Recorded, recorded
from valve.motion import simulate_motion


def random_regression(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    random = np.random.default_rng(seed)
    columns = random.standard_normal((3000, 4)) * np.array([100.0, 0.1, 1.0, 0.01])
    target = columns @ np.array([1.4, 600.0, 1400.0, 52000.0]) + random.standard_normal(3000)
    return columns, target, np.abs(random.standard_normal(3000))


def read(test: Recorded) -> RecordedMotion:
    motion = read_motion(test.recording, test.nameplate)
    assert not isinstance(motion, Outcome)
    return motion


def test_every_threshold_of_the_sweep_is_the_least_squares_of_its_rows() -> None:
    columns, target, speed = random_regression(1)
    sweep = sweep_thresholds(columns, target, speed, np.zeros((4, 4)), steps=1200, parts=1500)
    assert sweep.thresholds_m_per_s[1199] == pytest.approx(1200 * speed.max() / 1500)
    for step in (1, 2, 50, 400, 900):
        rows = speed > step * speed.max() / 1500
        assert sweep.rows[step - 1] == np.count_nonzero(rows)
        plain, squares, *_ = np.linalg.lstsq(columns[rows], target[rows], rcond=None)
        assert sweep.coefficients[step - 1] == pytest.approx(plain, rel=1.0e-9)
        variance = squares[0] / (np.count_nonzero(rows) - 4)
        error = np.sqrt(variance * np.diag(np.linalg.inv(columns[rows].T @ columns[rows])))
        assert sweep.std_error[step - 1] == pytest.approx(error, rel=1.0e-6)


def test_thresholds_that_leave_too_few_rows_are_undetermined() -> None:
    columns, target, speed = random_regression(2)
    speed[17] = 100.0
    sweep = sweep_thresholds(columns, target, speed, np.zeros((4, 4)), steps=1200, parts=1500)
    assert np.isinf(sweep.std_error[1199]).all()


def test_collinear_columns_are_undetermined_and_not_solved() -> None:
    columns, target, speed = random_regression(3)
    columns[:, 3] = 2.0 * columns[:, 2]
    assert np.isinf(sweep_thresholds(columns, target, speed, np.zeros((4, 4)), steps=5, parts=5).std_error).all()
    assert fit_linear(columns, target, speed > 0.0) is None


def test_least_squares_has_the_errors_that_repetition_shows() -> None:
    found, stated = [], []
    for seed in range(200):
        random = np.random.default_rng(seed)
        columns = np.column_stack([np.ones(400), np.linspace(-1.0, 1.0, 400)])
        noise = np.convolve(random.standard_normal(404), np.ones(5), mode="valid")
        fit = fit_linear(columns, columns @ np.array([3.0, 2.0]) + noise, np.ones(400, dtype=np.bool_))
        assert fit is not None
        found.append(fit.coefficients)
        stated.append(fit.std_error)
    assert np.mean(stated, axis=0) == pytest.approx(np.std(found, axis=0), rel=0.25)


def test_attenuation_by_noise_in_a_column_is_foreseen() -> None:
    random = np.random.default_rng(5)
    true = random.standard_normal(20_000)
    measured = true + 0.5 * random.standard_normal(20_000)
    every = np.ones(20_000, dtype=np.bool_)
    fit = fit_linear(measured[:, None], 3.0 * true, every, np.array([[0.25]]))
    assert fit is not None
    assert fit.coefficients[0] == pytest.approx(3.0 / 1.25, rel=0.02)
    assert fit.noise_bias[0] == pytest.approx(3.0 - 3.0 / 1.25, rel=0.1)


def test_doubtful_rows_that_contradict_the_rest_are_left_out() -> None:
    columns, target, _ = random_regression(6)
    spoiled = np.arange(3000) < 10
    target[spoiled] += 1.0e5
    every = np.ones(3000, dtype=np.bool_)
    fit = fit_trimmed(columns, target, every, spoiled | (np.arange(3000) < 20))
    assert fit is not None
    assert fit.samples == 2990
    assert fit.coefficients == pytest.approx([1.4, 600.0, 1400.0, 52000.0], rel=2.0e-3)


def test_noise_of_differences_is_as_computed() -> None:
    random = np.random.default_rng(8)
    position_m = 20.0e-6 * random.standard_normal(200_000)
    test = recorded("nominal", period_s=0.01)
    samples = prepare(test.recording, test.nameplate)
    assert isinstance(samples, Samples)
    count = position_m.size
    long = dataclasses.replace(
        samples,
        time_s=np.arange(count, dtype=np.float64) * 1.0e-3,
        position_m=position_m,
        force_n=np.zeros(count),
        run_first=np.zeros(count, dtype=np.int64),
        run_last=np.full(count, count - 1, dtype=np.int64),
    )
    velocity, acceleration = backward_differences(long)
    seen = np.cov(np.stack([acceleration[2:], velocity[2:], position_m[2:]]))
    assert seen == pytest.approx(noise_covariance(20.0e-6, 1.0e-3), rel=0.02)
    for half_window in (1, 10):
        slope = windowed_slope(long, position_m, half_window)[100:-100]
        assert float(slope.std()) == pytest.approx(windowed_slope_noise(20.0e-6, half_window, 1.0e-3), rel=0.02)


@pytest.mark.parametrize("viscous", [50.0, 400.0, 534.75, 613.0, 3000.0])
def test_bias_is_undone_at_any_damping(viscous: float) -> None:
    mass, spring, period_s = 1.3608, 52538.0, 1.0e-3
    rates = np.roots([mass, viscous, spring]).astype(np.complex128)
    steps = (1.0 - np.exp(-rates * period_s)) / period_s
    fitted_mass = (spring / np.prod(steps)).real
    fitted_viscous = (-fitted_mass * np.sum(steps)).real
    undone = without_bias(float(fitted_mass), float(fitted_viscous), spring, period_s)
    assert undone is not None
    assert undone.mass_kg == pytest.approx(mass, rel=1.0e-6)
    assert undone.viscous_n_s_per_m == pytest.approx(viscous, rel=1.0e-6)
    assert undone.slow_s == pytest.approx(sum(1.0 / abs(rate) for rate in rates), rel=1.0e-6)


def test_bias_without_a_mass_is_undone() -> None:
    rate = -206941.0 / 70501.0
    fitted = -206941.0 / ((1.0 - np.exp(-rate * 0.05)) / 0.05)
    assert without_bias_massless(fitted, 206941.0, 0.05) == pytest.approx(70501.0, rel=1.0e-9)


def test_what_is_no_valve_has_no_bias_to_undo() -> None:
    assert without_bias(-1.0, 600.0, 52538.0, 1.0e-3) is None
    assert without_bias(1.0, -600.0, 52538.0, 1.0e-3) is None
    assert without_bias_massless(-5.0, 52538.0, 1.0e-3) is None


@pytest.mark.parametrize("name", ["vendor", "nominal", "rough", "graphite"])
@pytest.mark.parametrize("noise_m", [0.0, 5.0e-6])
def test_breakaways_are_found_where_they_are(name: str, noise_m: float) -> None:
    test = recorded(name, noise_m=noise_m)
    area_m2 = test.nameplate.actuator.diaphragm_area_m2
    pressure_pa = test.recording.pressure_pa
    assert area_m2 is not None
    assert pressure_pa is not None
    fine_s = np.linspace(0.0, 60.0, 600_001)
    exact = simulate_motion(test.truth, test.recording.time_s, area_m2 * pressure_pa, fine_s)
    moving = np.abs(exact.velocity_m_per_s) > 0.0
    starts_s = fine_s[np.flatnonzero(moving[1:] & ~moving[:-1]) + 1]
    phases = read(test).phases
    found_s = np.array([breakaway.time_s for breakaway in phases.breakaways])
    assert found_s.size == 6
    tolerance_s = 0.6e-3 if noise_m == 0.0 else 8.0e-3
    assert np.abs(found_s - starts_s[np.searchsorted(starts_s, found_s - 0.05)]).max() < tolerance_s
    assert [breakaway.direction for breakaway in phases.breakaways] == [1, -1, 1, -1, 1, -1]


def test_slow_motion_is_not_mistaken_for_rest() -> None:
    samples = read(recorded("nominal", noise_m=5.0e-6)).samples
    crest = 0.05 + 0.02 * np.sin(2.0 * np.pi * samples.time_s / 8.0)
    noisy = crest + 5.0e-6 * np.random.default_rng(4).standard_normal(crest.size)
    phases = find_phases(dataclasses.replace(samples, position_m=noisy))
    assert not isinstance(phases, Outcome)
    # a sine stands still for an instant at each of its 15 crests and nowhere else
    assert len(phases.breakaways) <= 15


def test_differences_stop_at_a_missing_row_and_at_a_missing_slot() -> None:
    test = recorded("nominal", period_s=0.01)
    position_m = test.recording.position_m.copy()
    position_m[100:103] = np.nan
    later = np.arange(position_m.size) >= 200
    recording = dataclasses.replace(
        test.recording, position_m=position_m, time_s=test.recording.time_s + np.where(later, 0.01, 0.0)
    )
    samples = prepare(recording, test.nameplate)
    assert isinstance(samples, Samples)
    assert sorted(set(samples.run_first.tolist())) == [0, 100, 197]
    velocity, acceleration = backward_differences(samples)
    assert np.flatnonzero(np.isnan(velocity)).tolist() == [0, 100, 197]
    assert np.flatnonzero(np.isnan(acceleration)).tolist() == [0, 1, 100, 101, 197, 198]
    steps = np.where(np.arange(samples.count) >= 100, 1.0, 0.0)
    assert windowed_slope(samples, steps, 5).max() == 0.0


def test_the_inverse_from_cholesky_reads_nothing_above_the_diagonal() -> None:
    columns = np.random.default_rng(4).standard_normal((60, 40))
    matrix = columns.T @ columns
    lower: FloatArray = np.linalg.cholesky(matrix).astype(np.float64) + np.triu(np.full((40, 40), np.nan), 1)
    assert inverse_of(lower) == pytest.approx(np.linalg.inv(matrix), rel=1.0e-9)
