"""The compiled input path: from the force that the command asks for to the one that acts, corner by corner."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve.kernel.compiled import kernel

LONGEST_REST_IN_LAGS: Final = 36.0  # after so many time constants a lag has nothing left in double precision


@kernel
def transformed(time, force, gain, leak, limit, dead_time):
    """Corners after dead time, gain, limit and leak; a corner is put where a line meets the limit."""
    n = time.size
    out_time, out_force = np.empty(2 * n + 1), np.empty(2 * n + 1)
    count = 0
    if dead_time > 0.0:
        out_time[0], out_force[0] = time[0], (1.0 - leak) * min(gain * force[0], limit)
        count = 1
    for i in range(n):
        now = gain * force[i]
        if i > 0 and time[i] > time[i - 1]:
            before = gain * force[i - 1]
            if (before - limit) * (now - limit) < 0.0:
                share = (limit - before) / (now - before)
                out_time[count] = time[i - 1] + share * (time[i] - time[i - 1]) + dead_time
                out_force[count] = (1.0 - leak) * limit
                count += 1
        out_time[count], out_force[count] = time[i] + dead_time, (1.0 - leak) * min(now, limit)
        count += 1
    return out_time[:count], out_force[:count]


@kernel
def chords(start_gap, duration, lag, error):
    """Number of chords that keep within ``error`` of a lag's answer to one line that begins ``start_gap`` off it."""
    root = math.sqrt(abs(start_gap) / (8.0 * error))
    # sqrt(2): where chords are as long as the lag, the curvature at a chord's start is up to twice its mean
    return max(1, math.ceil(2.0 * math.sqrt(2.0) * root * (1.0 - math.exp(-0.5 * duration / lag))))


@kernel
def lagged_corners(time, force, end, lag, start_force, error):
    """Corners of lag F' = u - F for u through these corners and held to ``end``; chords leave it by ``error``.

    F(t) = u(t) - a T + (F_0 - u_0 + a T) exp(-t/T) on u = u_0 + a t; corners are even in exp(-t/2T), as close as
    the curvature asks. A first pass counts them.
    """
    n = time.size
    out_time, out_force = np.empty(0), np.empty(0)
    for write in range(2):
        count, now = 1, start_force
        if write == 1:
            out_time[0], out_force[0] = time[0], now
        kept, kept_fade = -1.0, 0.0
        for i in range(n):
            until = time[i + 1] if i + 1 < n else end
            duration = until - time[i]
            if duration <= 0.0:
                continue
            slope = (force[i + 1] - force[i]) / duration if i + 1 < n else 0.0
            gap = now - force[i] + slope * lag
            pieces = 1
            if abs(gap) * duration * duration > 8.0 * error * lag * lag:
                pieces = chords(gap, duration, lag, error)
            if abs(duration - kept) > 1.0e-12 * duration:
                kept, kept_fade = duration, math.exp(-duration / lag)
            last = math.exp(-0.5 * min(duration / lag, LONGEST_REST_IN_LAGS))
            for piece in range(1, pieces + (1 if duration > LONGEST_REST_IN_LAGS * lag else 0)):
                if write == 1:
                    fade = 1.0 + (last - 1.0) * piece / pieces
                    after = -2.0 * lag * math.log(fade)
                    out_time[count] = time[i] + after
                    out_force[count] = force[i] + slope * (after - lag) + gap * fade * fade
                count += 1
            now = force[i] + slope * (duration - lag) + gap * kept_fade
            if write == 1:
                out_time[count], out_force[count] = until, now
            count += 1
        if write == 0:
            out_time, out_force = np.empty(count), np.empty(count)
    return out_time, out_force
