"""The jump by itself beside the jumps of the exact motion: how far, after which force, and back from the length."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.likelihood.jump_kernel import breakaway, jump_excess, jump_length
from valve.motion import simulate_motion
from valve.parameters import ValveParameters
from valve.stem import Mode, StemState

SPRING, MASS, COULOMB, STATIC, LIMIT, RATE = 1.0e5, 10.0, 60.0, 75.0, 2.0e-5, 130.0
STEP_S = 1.0e-5


def _jump_of_motion(viscous: float) -> tuple[float, float]:
    """Return the length, m, of the second jump on a ramp, and the force above F_s, N, at which it reached DV."""
    valve = ValveParameters(MASS, SPRING, viscous, COULOMB, STATIC, LIMIT)
    time_s = np.arange(0.0, 1.2, STEP_S)
    motion = simulate_motion(valve, [0.0, 1.2], [0.0, 1.2 * RATE], time_s, initial=StemState())
    slips = np.flatnonzero(np.diff((motion.mode == Mode.SLIP).astype(int)) == 1)
    rests = np.flatnonzero(motion.mode == Mode.STUCK)
    before, after = rests[rests < slips[1]][-1], rests[rests > slips[1]][0]
    before_m, after_m = motion.position_m[[before, after]].tolist()
    return after_m - before_m, RATE * float(motion.time_s[slips[1] + 1]) - SPRING * before_m - STATIC


@pytest.mark.parametrize("viscous", [0.0, 60.0, 600.0])
def test_a_jump_is_as_long_as_in_the_whole_motion_and_breaks_away_under_its_force(viscous: float) -> None:
    length_m, risen_n = _jump_of_motion(viscous)
    more_n, before_m = breakaway(MASS, SPRING, LIMIT, RATE)
    assert more_n == pytest.approx(risen_n, abs=STEP_S * RATE)
    excess_n = STATIC + more_n - COULOMB
    assert jump_length(MASS, SPRING, viscous, LIMIT, RATE, before_m, excess_n) == pytest.approx(length_m, rel=1.0e-9)
    assert jump_excess(MASS, SPRING, viscous, LIMIT, RATE, before_m, length_m) == pytest.approx(excess_n, rel=1.0e-9)


def test_what_does_not_jump_has_no_length() -> None:
    more_n, before_m = breakaway(MASS, SPRING, LIMIT, RATE)
    # so damped that the stem slides on behind the ramp
    assert math.isnan(jump_length(MASS, SPRING, 4000.0, LIMIT, RATE, before_m, STATIC + more_n - COULOMB))
    # a DV that the stem does not reach before the spring has taken the force
    assert math.isnan(breakaway(MASS, SPRING, 2.1 * RATE / SPRING, RATE)[0])
    # no force makes a jump that is shorter than its breakaway
    assert math.isnan(jump_excess(MASS, SPRING, 60.0, LIMIT, RATE, before_m, 0.5 * before_m))
