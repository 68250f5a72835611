"""A stick-slip under much noise: where it rests, and how fast it is between."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from discrepancy.observed import Observed, observe
from discrepancy.pace import speeds
from estimators.likelihood.search import measured_rests
from estimators.motion.recorded_motion import RecordedMotion
from tests.blind.cases import blind_case


@cache
def jumping() -> RecordedMotion:
    """Seventy jumps of 3.7 mm within 10 ms each, 50 um of noise at 1 ms."""
    case = blind_case(7423, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    return observed.motions[0]


def test_the_end_of_a_jump_that_looks_still_for_a_few_milliseconds_is_no_rest() -> None:
    samples, rests = jumping().samples, measured_rests(jumping())
    assert rests.row.size == pytest.approx(67, abs=5)  # a few short ones are not seen beside the noise
    beside_m = samples.position_m[rests.row[:, None] + np.arange(-20, 21)]
    off_m = np.abs(beside_m.mean(axis=1) - rests.position_m)
    assert off_m.max() < 5.0 * samples.position_noise_m / np.sqrt(41.0)


def test_a_jump_that_is_shorter_than_the_window_of_the_velocity_has_its_own_speed() -> None:
    motion = jumping()
    assert np.abs(motion.phases.velocity).max() < 0.05
    speed = speeds(motion)
    assert 0.3 < speed.max() < 0.6
    resting = np.zeros(motion.samples.count, dtype=np.bool_)
    resting[measured_rests(motion).row] = True
    assert speed[resting].max() < 0.05
