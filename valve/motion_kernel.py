"""The compiled heart of valve.motion: one pass over the corners of the force, from event to event.

All kernels share this file because numba renews a cached function only when its own file changes.
In each mode the stem obeys m x'' + F_v x' + k x = affine force, so with c = F_v/m and w2 = k/m and from
position x, velocity v, acceleration a and r = (force rate - k v)/m it is after a time tau at

    x + v tau + a S1 + r S2,    v + a S + r S1,    a S' + r S,

where S is the impulse response of y'' + c y' + w2 y = 0, and S1 and S2 are its integrals. This one form
holds for every damping and for k = 0. Times are in s, lengths in m, forces in N, the mass in kg.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit

STUCK: Final = 0  # at rest, held by static friction
BAND: Final = 1  # |v| < DV, accelerated by what exceeds F_s
SLIP: Final = 2  # |v| >= DV, Coulomb and viscous friction
SLIDE: Final = 3  # v = +-DV, between F_s and F_c + F_v DV
STOPPED: Final = 4  # at rest on a travel stop

FOLLOWED: Final = 0
TOO_MANY_EVENTS: Final = 1
ROOT_NOT_FOUND: Final = 2

INVERSE_FACTORIAL: Final = np.array([1.0 / math.factorial(n) for n in range(24)])
BLOCK: Final = 128  # samples that share one closed-form anchor
LONGEST_BLOCK_STEP_S: Final = 0.01  # keeps v tau in a block, and its rounding, below a travel
MOST_ROOT_STEPS: Final = 1_000_000

# Any: the decorated kernels are typed by numba, from their arguments
kernel: Any = njit(cache=True, error_model="numpy")


@kernel
def impulse_response(tau, c, w2):
    """Return S', S, S1 and S2 after tau, each to rounding at any damping, critical included."""
    b, d = c * tau, w2 * tau * tau
    if b < 1.0 and d < 0.25:
        # Taylor: the closed forms of S1 and S2 cancel here
        p, before = 1.0, 0.0
        rate = value = once = twice = 0.0
        for n in range(20):
            rate += p * INVERSE_FACTORIAL[n]
            value += p * INVERSE_FACTORIAL[n + 1]
            once += p * INVERSE_FACTORIAL[n + 2]
            twice += p * INVERSE_FACTORIAL[n + 3]
            p, before = -b * p - d * before, p
        return rate, value * tau, once * tau * tau, twice * tau * tau * tau
    half = 0.5 * c
    gap = half * half - w2
    if gap < 0.0:
        omega = math.sqrt(-gap)
        decay = math.exp(-half * tau)
        value = decay * math.sin(omega * tau) / omega
        rate = decay * math.cos(omega * tau) - half * value
        once = (1.0 - rate - c * value) / w2
        return rate, value, once, (tau - value - c * once) / w2
    # roots -slow and -fast; slow by Vieta, so that it keeps its digits when heavily overdamped
    spread = 2.0 * math.sqrt(gap)
    fast = half + 0.5 * spread
    slow = w2 / fast
    decay = math.exp(-slow * tau)
    u = slow * tau
    if u < 0.5:
        phi, p = 0.0, 1.0
        for n in range(16):
            phi += p * INVERSE_FACTORIAL[n + 2]
            p *= -u
        first = tau * (1.0 - u * phi)
        second = tau * tau * phi
    else:
        first = (1.0 - decay) / slow
        second = (tau - first) / slow
    u = spread * tau
    if u > 1.0:
        decay_fast = math.exp(-u)
        value = decay * (1.0 - decay_fast) / spread
        rate = decay * (fast * decay_fast - slow) / spread
    else:
        value = decay * (-math.expm1(-u) / spread if u > 0.0 else tau)
        rate = decay - fast * value
    once = (first - value) / fast
    return rate, value, once, (second - once) / fast


@kernel
def regime(k, F_v, F_c, F_s, DV, low, high, x, v, net, slope, rounding):
    """Return the mode in which the stem goes on, and its direction (the sign of v, in the band of the force)."""
    tol = 1.0e-11 * F_s + rounding
    if (x >= high and v >= 0.0) or (x <= low and v <= 0.0):
        away = -1.0 if x >= high else 1.0
        y = away * net - F_s
        leaves = y > tol or (y >= -tol and away * slope > 0.0)
        return (BAND if leaves else STOPPED), away
    if abs(v) > DV * (1.0 + 1.0e-12):
        return SLIP, (1.0 if v > 0.0 else -1.0)
    if abs(v) < DV * (1.0 - 1.0e-12):
        if F_s <= tol and abs(net) <= tol:
            # no static friction: as with very little of it, the stem is caught where the force passes zero
            return (BAND if v == 0.0 and slope != 0.0 else STUCK), (1.0 if slope > 0.0 else -1.0)
        s = 1.0 if net > 0.0 else -1.0
        y = s * net - F_s
        grows = s * (slope - k * v) > 0.0
        return (BAND if y > tol or (y >= -tol and grows) else STUCK), s
    # |v| = DV: the fields on both sides decide (Filippov)
    s = 1.0 if v > 0.0 else -1.0
    y, moving = s * net, F_c + F_v * DV
    rate = s * slope - k * DV
    flat = 1.0e-12 * (abs(slope) + k * DV)
    if y > moving + tol or (y >= moving - tol and rate > flat):
        return SLIP, s
    if y > F_s + tol or (y >= F_s - tol and moving >= F_s - tol and rate >= -flat):
        return SLIDE, s
    if y < -F_s - tol or (y <= -F_s + tol and rate < -flat and F_s > tol):
        return BAND, -s
    return STUCK, s


@kernel
def band_reach(gain, alpha, beta, w2):
    """Time in which the band's velocity, from acceleration alpha and jerk beta, gains ``gain``; inf if never."""
    inside = alpha * alpha + gain * (2.0 * beta - gain * w2)
    if inside < 0.0:
        return math.inf
    below = alpha + math.sqrt(inside)
    if below <= 0.0:
        return math.inf
    half_tangent = gain / below
    w = math.sqrt(w2)
    return 2.0 * math.atan(w * half_tangent) / w if w > 0.0 else 2.0 * half_tangent


@kernel
def band_capture(y, y_rate, w2):
    """Time in which the excess force y >= 0 of the undamped band falls to 0; inf if never."""
    if w2 > 0.0:
        w = math.sqrt(w2)
        return math.atan2(y * w, -y_rate) / w
    return -y / y_rate if y_rate < 0.0 else math.inf


@kernel
def slip_end(c, w2, DV, s, v, a, push, horizon):
    """First time before ``horizon`` at which s v falls to DV, inf if there is none, NaN if it was not found.

    ``push`` is (force rate)/m. Each step h = 2g/(sqrt(g'^2 + 2 M g) - g') is short enough to hold no root,
    because M bounds |g''| from here on: the energy of any derivative of the homogeneous motion only falls.
    """
    r = push - w2 * v
    gap = 0.25 * c * c - w2
    real = gap > 1.0e-6 * c * c
    fast = 0.5 * c + math.sqrt(gap) if real else 0.0
    slow = w2 / fast if real else 0.0
    tol = 1.0e-13 * DV + 2.0e-16 * abs(v)
    tau, v_now, a_now = 0.0, v, a
    for _ in range(MOST_ROOT_STEPS):
        j_now = push - w2 * v_now - c * a_now
        g, g1, g2 = s * v_now - DV, s * a_now, s * j_now
        # |v''| <= M and |v'''| <= M3 for all later times
        M = math.sqrt(j_now * j_now + w2 * a_now * a_now)
        k_now = -c * j_now - w2 * a_now
        M3 = math.sqrt(k_now * k_now + w2 * j_now * j_now)
        swing = math.inf
        if w2 > 0.0:
            u_now = v_now - push / w2
            swing = math.sqrt(u_now * u_now + a_now * a_now / w2)
        if real:
            # tighter where the motion is a sum of two decays
            weak = abs(j_now + fast * a_now) / (fast - slow)
            strong = abs(j_now + slow * a_now) / (fast - slow)
            M = min(M, slow * weak + fast * strong)
            M3 = min(M3, slow * slow * weak + fast * fast * strong)
            if slow > 0.0:
                swing = min(swing, weak / slow + strong / fast)
        if w2 > 0.0 and s * push / w2 - swing > DV:
            return math.inf
        if tau > 0.0 and g <= tol and g1 <= 0.0:
            return tau
        g = max(g, 0.0)
        if M > 0.0:
            root = math.sqrt(g1 * g1 + 2.0 * M * g)
            h = (g1 + root) / M if g1 > 0.0 else (2.0 * g / (root - g1) if g > 0.0 else 0.0)
        else:
            h = math.inf if g1 >= 0.0 else -g / g1
        if g1 >= 0.0 and g2 > 0.0:
            h = max(h, 3.0 * g2 / M3) if M3 > 0.0 else math.inf
        if tau + h >= horizon:
            return math.inf
        if tau + h == tau:
            return tau
        tau += h
        S_rate, S, S1, _unused = impulse_response(tau, c, w2)
        v_now = v + a * S + r * S1
        a_now = a * S_rate + r * S
    return math.nan


@kernel
def stop_time(c, w2, x, v, a, r, stop, heading, early, late):
    """Time in [early, late], over which the stem moves towards ``heading``, at which it is at ``stop``."""
    lo, hi, tau = early, late, early
    for _ in range(200):
        _rate, S, S1, S2 = impulse_response(tau, c, w2)
        miss = stop - (x + v * tau + a * S1 + r * S2)
        if heading * miss > 0.0:
            lo = tau
        else:
            hi = tau
        speed = v + a * S + r * S1
        guess = tau + miss / speed if speed != 0.0 else math.inf
        if not lo <= guess <= hi:
            guess = 0.5 * (lo + hi)
        if abs(guess - tau) <= 4.0e-16 * late:
            return guess
        tau = guess
    return tau


@kernel
def stop_between(c, w2, x, v, a, r, low, high, heading, early, late):
    """Time in [early, late], moving towards ``heading`` all the while, at which a stop is met; inf if none is."""
    _rate, _S, S1, S2 = impulse_response(late, c, w2)
    stop = high if heading > 0.0 else low
    if heading * (x + v * late + a * S1 + r * S2 - stop) < 0.0:
        return math.inf
    return stop_time(c, w2, x, v, a, r, stop, heading, early, late)


@kernel
def band_end(m, w2, F_s, DV, low, high, s, x, v, net, slope, left):
    """Return the time to the end of the band within ``left``, and what ends it.

    0 nothing, 1 |v| = DV, 2 |F| = F_s, 3 the stop ahead (towards s), 4 the stop behind.
    """
    y = s * net - F_s if s * net > F_s else 0.0  # never -0.0, which atan2 would take half a turn back
    y_rate = s * slope - m * w2 * s * v
    capture = band_capture(y, y_rate, w2)
    reach = band_reach(DV - s * v, y / m, y_rate / m, w2)
    dwell, why = left, 0
    if reach <= capture and reach < left:
        dwell, why = reach, 1
    elif capture < left:
        dwell, why = capture, 2
    if x - low > 2.0 * DV * dwell and high - x > 2.0 * DV * dwell:
        return dwell, why
    # first against the force to standstill, then along it: each leg keeps its direction
    a, r, turn = s * y / m, s * y_rate / m, 0.0
    if s * v < 0.0:
        turn = min(dwell, band_reach(-s * v, y / m, y_rate / m, w2))
        met = stop_between(0.0, w2, x, v, a, r, low, high, -s, 0.0, turn)
        if met <= turn:
            return met, 4
    if turn < dwell:
        met = stop_between(0.0, w2, x, v, a, r, low, high, s, turn, dwell)
        if met <= dwell:
            return met, 3
    return dwell, why


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
def rest_end(F_s, mode, away, net, slope, left):
    """Return (time, whether it ended) of a rest within ``left``: until |F| = F_s, on a stop only away from it."""
    heading = 1.0 if slope > 0.0 else -1.0
    if slope == 0.0 or (mode == STOPPED and heading != away):
        return left, False
    release = max((F_s - heading * net) / abs(slope), 0.0)
    return min(release, left), release < left


@kernel
def slide_end(k, F_v, F_c, F_s, DV, low, high, s, x, net, slope, left):
    """Return (time, whether it ended, position, velocity) of a slide within ``left``."""
    dwell, ended = left, False
    rate = s * slope - k * DV
    if rate != 0.0:
        goal = F_c + F_v * DV if rate > 0.0 else F_s
        leave = max((goal - s * net) / rate, 0.0)
        dwell, ended = min(leave, left), leave < left
    room = (high - x if s > 0.0 else x - low) / DV
    if room <= dwell:
        return room, True, (high if s > 0.0 else low), 0.0
    return dwell, ended, x + s * DV * dwell, s * DV


@kernel
def band_step(m, w2, F_s, DV, low, high, s, x, v, a, r, net, slope, left):
    """Return (time, whether it ended, position, velocity) of a stay in the band within ``left``."""
    dwell, why = band_end(m, w2, F_s, DV, low, high, s, x, v, net, slope, left)
    if why >= 3:
        return dwell, True, (high if (s > 0.0) == (why == 3) else low), 0.0
    _rate, S, S1, S2 = impulse_response(dwell, 0.0, w2)
    return dwell, why > 0, x + v * dwell + a * S1 + r * S2, (s * DV if why == 1 else v + a * S + r * S1)


@kernel
def slip_step(c, w2, DV, low, high, s, x, v, a, r, push, left, memory):
    """Return (time, whether it ended, position, velocity) of a slip within ``left``.

    ``memory`` keeps the response of the last ``left``: periods that differ by rounding share it, corrected
    to first order.
    """
    d, w = left - memory[0], math.sqrt(w2)
    if not (abs(d) * (c + w) < 1.0e-8 and abs(d) < 1.0e-9 * left):
        memory[0] = left
        memory[1], memory[2], memory[3], memory[4] = impulse_response(left, c, w2)
        d = 0.0
    S, S1, S2 = memory[2] + d * memory[1], memory[3] + d * memory[2], memory[4] + d * memory[3]
    dwell, ended = left, False
    x_next, v_next = x + v * left + a * S1 + r * S2, v + a * S + r * S1
    # a curve stays above its chord's lower end less M left^2 / 8
    if min(s * v, s * v_next) - DV <= 0.125 * left * left * (abs(r - c * a) + w * abs(a)):
        root = slip_end(c, w2, DV, s, v, a, push, left)
        if not root >= left:
            dwell, ended = root, True
            _rate, S, S1, S2 = impulse_response(dwell, c, w2)
            x_next, v_next = x + v * dwell + a * S1 + r * S2, s * DV
    if x_next >= high or x_next <= low:
        met = stop_between(c, w2, x, v, a, r, low, high, s, 0.0, dwell)
        if met <= dwell:
            return met, True, (high if s > 0.0 else low), 0.0
    return dwell, ended, x_next, v_next


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
    for n in range(i, end):
        tau, S, S1, S2 = out_time[n] - offset, 0.0, 0.0, 0.0
        if tau != 0.0:
            _rate, S, S1, S2 = impulse_response(tau, c, w2)
        out_x[n] = x + v * tau + a * S1 + r * S2
        if out_v.size > 0:
            out_v[n] = v + a * S + r * S1


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
def follow(
    m, k, F_v, F_c, F_s, DV, F_0, low, high, x, v, mode,
    corner_time, corner_force, end_time,
    out_time, even_step, out_x, out_v, out_mode, out_force,
    event_time, event_mode, most_events,
):  # fmt: skip
    """Follow the stem from the first corner to ``end_time``; return (status, number of events, x, v, mode).

    ``corner_time`` never falls; two equal times make a step; after the last corner the force is held.
    ``out_time`` (from corner_time[0] to end_time, never falling) may be empty; ``even_step`` is its even
    period, 0 if it has none; out_v, out_mode and out_force may be empty where they are not wanted.
    An event is a change of mode: the first event_time.size of them are written, ``most_events`` followed.
    """
    w2, c = k / m, F_v / m
    n, n_out, n_events, out, pieces = corner_time.size, out_time.size, 0, 0, 0
    table, memory = np.zeros((4, BLOCK if n_out > 0 else 2)), np.full(5, math.nan)
    held_force = corner_force[0]
    if mode == STUCK and v == 0.0 and (x >= high or x <= low):
        mode = STOPPED
    for i in range(n):
        start, last = corner_time[i], i == n - 1
        if start > end_time:
            break
        stop = end_time if last else min(corner_time[i + 1], end_time)
        if stop == start:
            # of a step only the far side counts, and at the very end only where there was a step
            if (not last and corner_time[i + 1] == start) or i == 0 or corner_time[i - 1] < start:
                continue
            slope = 0.0
        else:
            slope = 0.0 if last else (corner_force[i + 1] - corner_force[i]) / (corner_time[i + 1] - start)
        span, tau, ended = stop - start, 0.0, True
        while ended:
            force = corner_force[i] + slope * tau
            net = force - k * x - F_0
            if x >= high:
                x, v = high, min(v, 0.0)
            elif x <= low:
                x, v = low, max(v, 0.0)
            # of the numbers that make up the net force, and of the time at which it is taken
            rounding = 1.0e-15 * (abs(force) + abs(k * x) + abs(F_0) + tau * (abs(slope) + k * abs(v)))
            now, s = regime(k, F_v, F_c, F_s, DV, low, high, x, v, net, slope, rounding)
            if (n_events == most_events and now != mode) or pieces > most_events:
                return TOO_MANY_EVENTS, n_events, x, v, mode
            if now != mode:
                mode = now
                if n_events < event_time.size:
                    event_time[n_events], event_mode[n_events] = start + tau, mode
                n_events += 1
            left, a = span - tau, 0.0
            x_next, v_next = x, 0.0
            if mode in (STUCK, STOPPED):
                v = 0.0
                dwell, ended = rest_end(F_s, mode, s, net, slope, left)
            elif mode == SLIDE:
                v = s * DV
                dwell, ended, x_next, v_next = slide_end(k, F_v, F_c, F_s, DV, low, high, s, x, net, slope, left)
            elif mode == BAND:
                a = (net - s * F_s) / m
                dwell, ended, x_next, v_next = band_step(
                    m, w2, F_s, DV, low, high, s, x, v, a, slope / m - w2 * v, net, slope, left
                )
            else:
                a = (net - s * F_c - F_v * v) / m
                if abs(v) <= DV * (1.0 + 1.0e-12):
                    v, a = s * max(abs(v), DV), s * max(s * a, 0.0)
                dwell, ended, x_next, v_next = slip_step(
                    c, w2, DV, low, high, s, x, v, a, slope / m - w2 * v, slope / m, left, memory
                )
                if math.isnan(dwell):
                    return ROOT_NOT_FOUND, n_events, x, v, mode
            begun, tau = tau, (tau + dwell if ended else span)
            pieces += ended
            ending = start + tau
            if out < n_out and out_time[out] < ending:
                if out_time[out] == start + begun and (out + 1 == n_out or out_time[out + 1] >= ending):
                    # one sample, at the anchor itself: the rule where the input is sampled too
                    out_x[out] = x
                    if out_v.size > 0:
                        out_v[out] = v
                    if out_mode.size > 0:
                        out_mode[out] = mode
                    if out_force.size > 0:
                        out_force[out] = force
                    out += 1
                else:
                    until = first_at_or_after(out_time, out, ending)
                    if mode in (SLIP, BAND):
                        damping, even = (c, even_step) if mode == SLIP else (0.0, 0.0)
                        sample_motion(
                            damping, w2, x, v, a, slope / m - w2 * v, slope / m, start + begun,
                            out, until, out_time, even, table, out_x, out_v,
                        )  # fmt: skip
                    else:
                        sample_straight(x, v, start + begun, out, until, out_time, out_x, out_v)
                    sample_marks(mode, corner_force[i], slope, start, out, until, out_time, out_mode, out_force)
                    out = until
            x, v = x_next, v_next
        held_force = corner_force[i] + slope * span
    sample_straight(x, 0.0, end_time, out, n_out, out_time, out_x, out_v)
    for n in range(out, n_out if out_v.size > 0 else out):
        out_v[n] = v
    sample_marks(mode, held_force, 0.0, end_time, out, n_out, out_time, out_mode, out_force)
    return FOLLOWED, n_events, x, v, mode


@kernel
def follow_many(
    parameters, position, velocity, mode, corner_time, corner_force, end_time,
    out_time, even_step, out_x, out_v, most_events, status, events,
):  # fmt: skip
    """Follow one valve a row of ``parameters`` (m, k, F_v, F_c, F_s, DV, F_0, low, high); states in place.

    ``corner_force`` and ``out_v`` may have one row only: the first is then shared, the second not written.
    """
    no_time, no_mode, no_force = np.empty(0), np.empty(0, np.int8), np.empty(0)
    for i in range(parameters.shape[0]):
        q = parameters[i]
        force = corner_force[i if corner_force.shape[0] > 1 else 0]
        row_v = out_v[i] if out_v.shape[0] > 1 else out_v[0]
        status[i], events[i], position[i], velocity[i], mode[i] = follow(
            q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], position[i], velocity[i], mode[i],
            corner_time, force, end_time, out_time, even_step, out_x[i], row_v, no_mode, no_force,
            no_time, no_mode, most_events,
        )  # fmt: skip


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
