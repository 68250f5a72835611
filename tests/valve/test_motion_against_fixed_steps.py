"""The exact motion against an integration by fixed steps that shares nothing with it."""

from dataclasses import astuple

import numpy as np
import numpy.typing as npt
import pytest

from tests.support.fixed_step import integrate
from tests.valve.random_valves import DURATION_S, KINDS, RandomValve, random_valve
from valve.motion import simulate_motion

EACH = 22  # 11 kinds: 242 valves, of which 236 move
STEPS_S = (2.0e-5, 1.0e-5, 5.0e-6, 2.5e-6)
OUTPUT_STEP_S = 1.0e-3


def errors(valve: RandomValve) -> npt.NDArray[np.float64]:
    """Largest position error of the fixed-step integration at each of STEPS_S, as a share of the way travelled."""
    output_time_s = np.arange(round(DURATION_S / OUTPUT_STEP_S) + 1) * OUTPUT_STEP_S
    exact = simulate_motion(valve.parameters, valve.force_time_s, valve.force_n, output_time_s, stops=valve.stops)
    numbers = (*astuple(valve.parameters), valve.stops.low_m, valve.stops.high_m)
    worst = []
    for step_s in STEPS_S:
        count, stride = round(DURATION_S / step_s), round(OUTPUT_STEP_S / step_s)
        stepped = integrate(*numbers, valve.force_time_s, valve.force_n, step_s, count, stride)
        worst.append(float(np.abs(stepped - exact.position_m).max()))
    return np.array(worst) / max(float(np.ptp(exact.position_m)), 1.0e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_error_of_fixed_steps_shrinks_in_proportion_to_the_step(kind: str) -> None:
    found = np.array([errors(random_valve(kind, seed)) for seed in range(1, EACH + 1)])
    moved = found[:, 0] > 0.0
    assert np.count_nonzero(moved) >= EACH - 3, "too few of these valves move: the comparison would say nothing"
    # an event falls anywhere inside a step, and without damping its error lasts: one valve follows only roughly
    shrinkage = found[moved, 0] / found[moved, -1]
    assert np.median(shrinkage) == pytest.approx(STEPS_S[0] / STEPS_S[-1], rel=0.35)
    assert shrinkage.min() > 1.5
    assert found[:, -1].max() < 1.0e-3
