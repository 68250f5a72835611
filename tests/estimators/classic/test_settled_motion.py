"""Uniform motion whose rows still hold the ends of slips: what is left of them is taken out, not doubled."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.base import Form
from estimators.classic.settled_motion import settled_motion
from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.slips.search import AFTER_THE_BALANCE, solve_slips
from tests.estimators.random_valves import random_test


@pytest.mark.parametrize("seed", [11, 21])
def test_the_spring_rate_and_preload_lose_what_the_slips_pull_at_them(seed: int) -> None:
    test = random_test(seed, "multi_rate")
    with np.errstate(all="ignore"):
        motion = read_motion(test.recording, test.nameplate)
        assert isinstance(motion, RecordedMotion)
        assert motion.uniform is not None
        found = solve_slips(motion, Balance.of(motion.uniform, Form.ROBUST, motion.action), AFTER_THE_BALANCE)
        assert found is not None
        settled = settled_motion(motion, found)
    assert settled is not None
    spring, preload = test.truth.spring_rate_n_per_m, test.truth.preload_n
    assert motion.uniform.preload_n is not None
    assert settled.preload_n is not None
    assert abs(settled.spring_n_per_m - spring) < 0.1 * abs(motion.uniform.spring_n_per_m - spring)
    assert abs(settled.preload_n - preload) < 0.1 * abs(motion.uniform.preload_n - preload)
