"""The balance of uniform motion admits what a speed that drifts does to it."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.classic.garcia import GarciaEstimator
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.motion.uniform_motion import _by_drift, _speed_drift
from tests.support.published_recordings import recorded
from tests.support.random_valves import random_test


def test_a_spring_rate_from_motion_that_is_not_quite_uniform_is_within_its_interval() -> None:
    # a sine behind whose overdamped stem the speed falls along one way: k was 1.5 % low, 8 of its standard errors
    test = random_test(2421)
    motion = read_motion(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert motion.uniform is not None
    off = motion.uniform.spring_n_per_m - test.truth.spring_rate_n_per_m
    assert abs(off) < 3.0 * motion.uniform.std_error[0]
    entry = GarciaEstimator().estimate(test.recording, test.nameplate).parameters["k"]
    assert entry.value is None or entry.std_error is not None


def test_a_ramp_has_no_drift_beyond_its_noise() -> None:
    time_s = np.linspace(-1.0, 1.0, 1000)
    noise_m = 1.0e-5 * np.random.default_rng(1).standard_normal(1000)
    assert not _speed_drift(time_s, 1.0e-3 * time_s + noise_m, 1.0e-5).any()
    drift = _speed_drift(time_s, 1.0e-3 * time_s + 1.0e-4 * time_s**2 + noise_m, 1.0e-5)
    assert drift == pytest.approx(2.0e-4 * time_s, abs=1.0e-5)


def test_drift_adds_what_the_friction_may_do_with_it() -> None:
    position_m = np.linspace(0.0, 1.0, 50)
    matrix = np.stack([position_m, np.ones(50)], axis=1)
    # F_v drift = 10 N s/m * 0.1 m/s along a way of 1 m looks like 1 N/m of spring
    covariance = _by_drift(matrix, 0.1 * (position_m - 0.5), 10.0)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(1.0 / np.sqrt(3.0))


def test_a_triangle_is_as_well_known_as_before() -> None:
    test = recorded("vendor", period_s=1.0e-2, noise_m=5.0e-6, seed=3)
    motion = read_motion(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert motion.uniform is not None
    assert motion.uniform.std_error[0] / motion.uniform.spring_n_per_m < 1.0e-5
