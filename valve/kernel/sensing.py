"""What a sensor shows of the stem: gain, bow, play and lag, and the writing of one output."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math

from valve.kernel.compiled import kernel
from valve.kernel.slots import (
    BOW,
    BOW_ENDS,
    BOW_LOW,
    BOW_SKEW,
    BOW_SPAN,
    GAIN,
    GAIN_REFERENCE,
    LAGGED,
    PLAY,
    PLAYED,
    POSITION_LAG,
    SHOWN,
)


@kernel
def displayed(q, played):
    """Position that a sensor with its gain and bow makes of what its lever follows."""
    y = played
    if q[BOW] != 0.0:
        u = (y - q[BOW_LOW]) / q[BOW_SPAN]
        way = 2.0 * u - 1.0
        y += 4.0 * q[BOW] * u * (1.0 - u) * (1.0 + way * (q[BOW_SKEW] + q[BOW_ENDS] * way))
    return q[GAIN_REFERENCE] + q[GAIN] * (y - q[GAIN_REFERENCE])


@kernel
def sense(q, state, x, dt):
    """Let the sensor follow a stem that went straight to x in ``dt``; its reading is state[LAGGED]."""
    half = 0.5 * q[PLAY]
    state[PLAYED] = min(max(state[PLAYED], x - half), x + half)
    shown, before, T = displayed(q, state[PLAYED]), state[SHOWN], q[POSITION_LAG]
    if T > 0.0:
        if dt > 0.0:
            way = (shown - before) / dt * T
            state[LAGGED] = shown - way + (state[LAGGED] - before + way) * math.exp(-dt / T)
    else:
        state[LAGGED] = shown
    state[SHOWN] = shown


@kernel
def sampled(i, x, sensed, v, mode, force, out_x, out_sensed, out_v, out_mode, out_force):
    """Write one output and return the number of the next."""
    out_x[i], out_sensed[i], out_v[i], out_mode[i], out_force[i] = x, sensed, v, mode, force
    return i + 1


@kernel
def sampled_rest(
    i, until, out_time, q, state, sensing, x, mode, since, start, force, slope,
    out_x, out_sensed, out_v, out_mode, out_force,
):  # fmt: skip
    """Write the outputs before ``until`` of a stem that rests at x; return the number of the next.

    ``state`` is the sensor's at the time ``since``; the force goes straight from ``force`` at ``start``.
    """
    while i < out_time.size and out_time[i] < until:
        settled = state[SHOWN] if sensing else x
        if q[POSITION_LAG] > 0.0:
            settled += (state[LAGGED] - settled) * math.exp((since - out_time[i]) / q[POSITION_LAG])
        i = sampled(
            i, x, settled, 0.0, mode, force + slope * (out_time[i] - start),
            out_x, out_sensed, out_v, out_mode, out_force,
        )  # fmt: skip
    return i
