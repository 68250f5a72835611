"""Outputs between two events: positions and velocities in blocks, modes and forces; and checks of their times."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.response import impulse_response, settling_time

BLOCK: Final = 128  # samples that share one closed-form anchor
LONGEST_BLOCK_STEP_S: Final = 0.01  # keeps v tau in a block, and its rounding, below a travel


@kernel
def first_at_or_after(values, begin, limit):
    """First index from ``begin`` on whose value is not below ``limit``; a galloping search."""
    n = values.size
    if begin >= n or values[begin] >= limit:
        return begin
    lo, step = begin, 1
    while lo + step < n and values[lo + step] < limit:
        lo += step
        step *= 2
    hi = min(lo + step, n)
    while hi - lo > 1:
        middle = (lo + hi) // 2
        if values[middle] < limit:
            lo = middle
        else:
            hi = middle
    return hi


@kernel
def sample_motion(c, w2, x, v, a, r, push, offset, i, end, out_time, even_step, table, out_x, out_v):
    """Write position and velocity at out_time[i:end] for a motion that began at the time ``offset``."""
    if even_step > 0.0 and end - i > 4:
        if table[0, 1] == 0.0:
            for n in range(BLOCK):
                table[0, n] = n * even_step
                _rate, table[1, n], table[2, n], table[3, n] = impulse_response(n * even_step, c, w2)
        while i < end:
            # a new closed-form anchor a block: nothing accumulates
            tau = out_time[i] - offset
            rate, S, S1, S2 = impulse_response(tau, c, w2)
            xb, vb, ab = x + v * tau + a * S1 + r * S2, v + a * S + r * S1, a * rate + r * S
            rb = push - w2 * vb
            count = min(BLOCK, end - i)
            part_x, part_v = out_x[i : i + count], out_v[i : i + count]
            for n in range(part_x.size):
                part_x[n] = xb + vb * table[0, n] + ab * table[2, n] + rb * table[3, n]
            for n in range(part_v.size):
                part_v[n] = vb + ab * table[1, n] + rb * table[2, n]
            i += count
        return
    settled = min(end, first_at_or_after(out_time, i, offset + settling_time(c, w2)))
    half = 0.5 * c
    gap = half * half - w2
    if gap > 0.0 and w2 > 0.0:
        # two decays, the fast one faded: as the response has it, without what no digit feels
        spread = 2.0 * math.sqrt(gap)
        fast = half + 0.5 * spread
        slow = w2 / fast
        faded = min(settled, first_at_or_after(out_time, i, offset + max(0.5 / slow, 50.0 / spread) * (1.0 + 1.0e-12)))
    else:
        spread, fast, slow, faded = 1.0, 1.0, 1.0, settled
    for n in range(i, faded):
        tau, S, S1, S2 = out_time[n] - offset, 0.0, 0.0, 0.0
        if tau != 0.0:
            _rate, S, S1, S2 = impulse_response(tau, c, w2)
        out_x[n] = x + v * tau + a * S1 + r * S2
        if out_v.size > 0:
            out_v[n] = v + a * S + r * S1
    for n in range(faded, settled):
        tau = out_time[n] - offset
        decay = math.exp(-slow * tau)
        first = (1.0 - decay) / slow
        S = decay / spread
        S1 = (first - S) / fast
        out_x[n] = x + v * tau + a * S1 + r * (((tau - first) / slow - S1) / fast)
        if out_v.size > 0:
            out_v[n] = v + a * S + r * S1
    if settled < end:
        sample_settled(c, w2, x, v, a, r, offset, settled, end, out_time, out_x, out_v)


@kernel
def sample_settled(c, w2, x, v, a, r, offset, i, end, out_time, out_x, out_v):
    """Write what ``sample_motion`` does, to the same rounding, where S' and S have faded."""
    part_t, part_x, part_v = out_time[i:end], out_x[i:end], out_v[i:end]
    half = 0.5 * c
    gap = half * half - w2
    if gap < 0.0:
        S1 = 1.0 / w2
        for n in range(part_x.size):
            tau = part_t[n] - offset
            part_x[n] = x + v * tau + a * S1 + r * ((tau - c * S1) / w2)
    else:
        fast = half + math.sqrt(gap)
        slow = w2 / fast
        first = 1.0 / slow
        S1 = first / fast
        for n in range(part_x.size):
            tau = part_t[n] - offset
            part_x[n] = x + v * tau + a * S1 + r * (((tau - first) / slow - S1) / fast)
    for n in range(part_v.size):
        part_v[n] = v + r * S1


@kernel
def sample_straight(x, v, offset, i, end, out_time, out_x, out_v):
    """Write position and velocity at out_time[i:end] for a stem at rest or at constant velocity."""
    part_t, part_x, part_v = out_time[i:end], out_x[i:end], out_v[i:end]
    for n in range(part_x.size):
        part_x[n] = x + v * (part_t[n] - offset)
    for n in range(part_v.size):
        part_v[n] = v


@kernel
def sample_marks(mode, force, slope, start, i, end, out_time, out_mode, out_force):
    """Write mode and force at out_time[i:end], where they are asked for."""
    part_t, part_mode, part_force = out_time[i:end], out_mode[i:end], out_force[i:end]
    for n in range(part_mode.size):
        part_mode[n] = mode
    for n in range(part_force.size):
        part_force[n] = force + slope * (part_t[n] - start)


@kernel
def first_fall(values):
    """Index of the first value that is below the one before it or is not finite; -1 if there is none."""
    n, falls = values.size, 0
    # counted without a branch, so that the usual answer comes quickly
    for i in range(n - 1):
        falls += not values[i + 1] >= values[i]
    if falls == 0 and (n == 0 or (math.isfinite(values[0]) and math.isfinite(values[n - 1]))):
        return -1
    for i in range(n):
        if not math.isfinite(values[i]) or (i > 0 and values[i] < values[i - 1]):
            return i
    return -1


@kernel
def even_period(times):
    """Period of times that are even to rounding and no coarser than LONGEST_BLOCK_STEP_S; 0 otherwise."""
    n = times.size
    if n < 2:
        return 0.0
    first, period = times[0], (times[n - 1] - times[0]) / (n - 1)
    if not 0.0 < period <= LONGEST_BLOCK_STEP_S:
        return 0.0
    limit, uneven = 4.0e-16 * max(abs(first), abs(times[n - 1])), 0
    for i in range(n):
        uneven += not abs(times[i] - (first + i * period)) <= limit
    return period if uneven == 0 else 0.0
