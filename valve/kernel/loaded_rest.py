"""How long a stem rests whose friction and load change over time."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.loads import extra_static, load, static_level, vibration_rate
from valve.kernel.slots import (
    DRIFT,
    DRIFT_TIME,
    DWELL_RISE,
    DWELL_TIME,
    F_0,
    F_S,
    PRESSURE_SHARE,
    STATIC_ASYMMETRY,
    STATIC_SHARE,
    VIBRATION,
    VIBRATION_RATE,
    K,
)

MOST_STEPS: Final = 100_000


@kernel
def rest_length(q, curves, x, t, force, slope, rested, never_moved, away, left):
    """Return (time, whether it ended) of a rest within ``left``; ``away`` 0, or the way off the stop that holds it.

    With M a bound of |g''| a step h = 2 g/(sqrt(g'^2 + 2 M g) - g') holds no root of a gap g, and converges.
    """
    tau = 0.0
    tol = 1.0e-13 * q[F_S] + 1.0e-15 * (abs(force) + abs(q[K] * x) + abs(q[F_0]))
    for _ in range(MOST_STEPS):
        net, more, area = load(q, curves, x, t + tau, force + slope * tau)
        rates, more_rate, bend, more_bend = slope * area, 0.0, 0.0, 0.0
        if q[VIBRATION] != 0.0:
            rates += vibration_rate(q, t + tau)
            bend = abs(q[VIBRATION]) * q[VIBRATION_RATE] * q[VIBRATION_RATE]
        if q[DRIFT] != 0.0:
            more_rate = q[STATIC_SHARE] * q[DRIFT] / q[DRIFT_TIME] * math.exp(-(t + tau) / q[DRIFT_TIME])
            more_bend = abs(more_rate) / q[DRIFT_TIME]
        if q[PRESSURE_SHARE] != 0.0:
            now = force + slope * tau
            grows = slope if now > 0.0 or (now == 0.0 and slope > 0.0) else -slope
            more_rate += q[STATIC_SHARE] * q[PRESSURE_SHARE] * grows
        extra = extra_static(q, rested + tau, never_moved)
        if q[DWELL_RISE] != 0.0:
            long = max(rested, 0.0) + tau + q[DWELL_TIME]
            more_rate += q[DWELL_RISE] * q[DWELL_TIME] / (long * long)
            more_bend += 2.0 * abs(q[DWELL_RISE]) * q[DWELL_TIME] / (long * long * long)
        step, gap = math.inf, math.inf
        for s in (1.0, -1.0):
            if away * s < 0.0:
                continue
            factor = 1.0 + s * q[STATIC_ASYMMETRY]
            g = static_level(q, s, more, extra) - s * net
            g1, bound = factor * more_rate - s * rates, factor * more_bend + bend
            g = max(g, 0.0)
            if bound > 0.0:
                root = math.sqrt(g1 * g1 + 2.0 * bound * g)
                h = (g1 + root) / bound if g1 > 0.0 else (2.0 * g / (root - g1) if g > 0.0 else 0.0)
            else:
                h = math.inf if g1 >= 0.0 else -g / g1
            step = min(step, h)
            if g1 < 0.0:
                gap = min(gap, g)
        if tau + step >= left:
            return left, False
        tau += step
        if gap <= tol or (bend == 0.0 and more_bend == 0.0) or step < 1.0e-15 * (1.0 + tau):
            return tau, True
    return tau, True
