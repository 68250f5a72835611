"""One stay in a mode: how long it lasts within what is left, what ends it, and where the stem is then."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math

from valve.kernel.compiled import kernel
from valve.kernel.first_roots import band_capture, band_reach, slip_end, stop_between
from valve.kernel.modes import STOPPED
from valve.kernel.response import impulse_response


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
