"""The Karnopp valve by fixed steps, as the paper simulates it: nothing here knows of modes or of events.

Romano & Garcia (2007), Eq. 1-2. Two rules decide whether it converges: the velocity becomes zero only where
static friction holds the force, and a step that leaps over the band is captured there all the same.
"""

# mypy: allow-untyped-defs
# numba types the loop from its arguments.
# ruff: noqa: PLR0917 - a compiled loop over flat numbers
from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

compiled: Any = njit(cache=True)


@compiled
def integrate(m, k, F_v, F_c, F_s, DV, F_0, low, high, corner_time, corner_force, step, count, stride):
    """Position every ``stride`` of ``count`` steps from rest at 0, m, shape (count / stride + 1,)."""
    positions = np.zeros(count // stride + 1)
    x, v, leg = 0.0, 0.0, 0
    for i in range(count):
        time = i * step
        while leg + 2 < corner_time.size and corner_time[leg + 1] <= time:
            leg += 1
        share = (time - corner_time[leg]) / (corner_time[leg + 1] - corner_time[leg])
        net = corner_force[leg] + share * (corner_force[leg + 1] - corner_force[leg]) - k * x - F_0
        held = abs(net) <= F_s
        if abs(v) < DV:
            v = 0.0 if held else v + step / m * (net - math.copysign(F_s, net))
        else:
            # viscous friction implicitly, so that a heavily damped stem stays stable
            after = (v + step / m * (net - math.copysign(F_c, v))) / (1.0 + step * F_v / m)
            v = 0.0 if held and after * v < 0.0 else after
        x += step * v
        if x >= high:
            x, v = high, min(v, 0.0)
        elif x <= low:
            x, v = low, max(v, 0.0)
        if (i + 1) % stride == 0:
            positions[(i + 1) // stride] = x
    return positions
