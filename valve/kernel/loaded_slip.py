"""A slip whose slots are not neutral: closed form between two anchors, corrected at its end.

What the slots add is a force that is taken straight in time over the anchor's step, from its value at the start to
that at the predicted end.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.first_roots import newton_step, stop_time
from valve.kernel.loads import coulomb_level, drag_at, load, static_level
from valve.kernel.response import impulse_response
from valve.kernel.slots import D_V, STRIBECK, VIBRATION, VIBRATION_PHASE, VIBRATION_RATE, M

STRIBECK_SHARE: Final = 0.15  # of v_s, by which the speed changes in one sub-step
SPEED_DEFECT_M_PER_S: Final = 2.0e-4  # by which the slots may correct a sub-step's speed; else it is halved
SHORTEST_CUT_S: Final = 2.0e-5
GLANCE_S: Final = 1.0e-6
MOST_ATTEMPTS: Final = 100  # to find a sub-step's length
SHORTEST_STEP_S: Final = 1.0e-9


@kernel
def turning_time(c, w2, a, r, late):
    """Time in [0, late] at which the acceleration passes zero; it does so once there."""
    lo, hi, tau, s = 0.0, late, 0.5 * late, math.copysign(1.0, a)
    for _ in range(100):
        rate, S, S1, _unused = impulse_response(tau, c, w2)
        now = a * rate + r * S
        guess, lo, hi = newton_step(tau, s * now, s * (r - w2 * (a * S + r * S1) - c * now), lo, hi)
        if abs(guess - tau) <= 4.0e-16 * late:
            return guess
        tau = guess
    return tau


@kernel
def speed_time(c, w2, v, a, r, s, speed, early, late):
    """Time in [early, late] at which s v falls to ``speed``; it is above at ``early`` and below at ``late``."""
    lo, hi, tau = early, late, 0.5 * (early + late)
    for _ in range(100):
        rate, S, S1, _unused = impulse_response(tau, c, w2)
        over = s * (v + a * S + r * S1) - speed
        guess, lo, hi = newton_step(tau, over, s * (a * rate + r * S), lo, hi)
        if abs(guess - tau) <= 4.0e-16 * late:
            return guess
        tau = guess
    return tau


@kernel
def fall_time(c, w2, v, a, r, s, speed, v_end, a_end, late):
    """First time in [0, late] at which s v falls to ``speed``; infinite if it stays above."""
    if s * v_end < speed:
        early = turning_time(c, w2, a, r, late) if s * a > 0.0 and s * a_end < 0.0 else 0.0
        return speed_time(c, w2, v, a, r, s, speed, early, late)
    if s * a < 0.0 and s * a_end > 0.0:
        turn = turning_time(c, w2, a, r, late)
        _rate, S, S1, _unused = impulse_response(turn, c, w2)
        if s * (v + a * S + r * S1) < speed:
            return speed_time(c, w2, v, a, r, s, speed, 0.0, turn)
    return math.inf


@kernel
def loaded_slip(
    q, curves, s, x, v, t, force, slope, h, rate, edge, low, high, net, coulomb, static, viscous, carried, memory
):  # fmt: skip
    """Return (time, whether it ended, position, velocity, slope of the slots' force, net force, friction added).

    Of a slip of at most ``h``. The friction's fall with speed is linearised at the start, so that the closed form
    carries it too. The last two are those at the end, where it did not end.
    """
    m, w2, v_s, more = q[M], rate / q[M], q[STRIBECK], 0.0
    stop = high if s > 0.0 else low
    drag = drag_at(q, coulomb, static, v)
    a, falling = (net - s * drag - viscous * v) / m, 0.0
    if abs(v) <= q[D_V] * (1.0 + 1.0e-12):
        v, a = s * max(abs(v), q[D_V]), s * max(s * a, 0.0)
    if v_s > 0.0:
        falling = -2.0 * s * v / (v_s * v_s) * (drag - coulomb)
        if s * v < 4.0 * v_s and abs(a) * h > STRIBECK_SHARE * v_s:
            h = STRIBECK_SHARE * v_s / abs(a)
    c = (viscous + falling) / m
    if c < 0.0:
        h = min(h, -0.3 / c)
    over, starting = 0.0, abs(v) <= q[D_V] * (1.0 + 1.0e-12) and s * a <= 0.0
    r, S_rate, S, S1, S2, x_end, v_end, a_end = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    defect, bent, change = 0.0, 0.0, 0.0
    for attempt in range(MOST_ATTEMPTS):
        d = h - memory[0]
        # periods that differ by rounding share a response, corrected to first order
        if not (abs(d) < 1.0e-13 and abs(d) < 1.0e-9 * h and memory[5] == c and memory[6] == w2):
            memory[0], memory[5], memory[6] = h, c, w2
            memory[1], memory[2], memory[3], memory[4] = impulse_response(h, c, w2)
            d = 0.0
        S_rate = memory[1] - d * (c * memory[1] + w2 * memory[2])
        S, S1, S2 = memory[2] + d * memory[1], memory[3] + d * memory[2], memory[4] + d * memory[3]
        over = 0.0
        if q[VIBRATION] != 0.0 and not starting and c * h < 1.0:
            # a chord lies inside a sine: its mean force is put right, unless damping makes the speed follow its ends
            turn = q[VIBRATION_RATE] * h
            ends = math.sin(q[VIBRATION_RATE] * t + q[VIBRATION_PHASE])
            ends += math.sin(q[VIBRATION_RATE] * (t + h) + q[VIBRATION_PHASE])
            over = q[VIBRATION] * ends * turn * turn / 24.0
        r = (slope + carried) / m - w2 * v
        x_end = x + v * h + (a + over / m) * S1 + r * S2
        v_end = v + (a + over / m) * S + r * S1
        a_end = (a + over / m) * S_rate + r * S
        slow = min(s * v, s * v_end) < 3.0 * v_s
        if attempt < MOST_ATTEMPTS // 2 and (
            v_s > 0.0 and slow and abs(v_end - v) > 2.0 * STRIBECK_SHARE * v_s and h > SHORTEST_STEP_S
        ):
            h *= 0.5
            continue
        if attempt < MOST_ATTEMPTS // 2 and s * (x_end - edge) > 1.0e-12 and h > SHORTEST_STEP_S:
            # what lies behind the edge must not count before it
            h = stop_time(c, w2, x, v, a + over / m, r, edge, s, 0.0, h)
            continue
        net, more, _area = load(q, curves, x_end, t + h, force + slope * h)
        drag_end, bent = coulomb_level(q, s, more), 0.0
        if v_s > 0.0:
            drag_end = drag_at(q, drag_end, static_level(q, s, more, 0.0), v_end)
            # what is left of the friction's fall is a parabola in time, of a third of the chord's excess of impulse
            bent = falling * (v_end - v) - s * (drag_at(q, coulomb, static, v_end) - drag)
        defect = net - s * drag_end - viscous * v_end + over - m * a_end
        change = (defect - bent / 3.0) / (h * m)
        if starting and s * (r + change) <= 0.0 and h > GLANCE_S:
            h *= 0.5
        elif abs(change) * S1 <= SPEED_DEFECT_M_PER_S or h <= SHORTEST_CUT_S:
            break
        else:
            h *= 0.5
    a, r, net = a + over / m, r + change, net - rate * change * S2
    x_end, v_end, a_end = x_end + change * S2, v_end + change * S1, a_end + change * S
    if h > SHORTEST_STEP_S:
        carried += (defect - bent) / h
    dwell, ended = h, False
    # between two speeds it dips by no more than the accelerations at its ends allow, four times over
    dips = s * a < 0.0 and s * a_end > 0.0 and min(s * v, s * v_end) - 4.0 * max(abs(a), abs(a_end)) * h < q[D_V]
    if s * v_end < q[D_V] or dips:
        root = fall_time(c, w2, v, a, r, s, q[D_V], v_end, a_end, h)
        if root <= h:
            # a touch at the very start must not stop the clock
            dwell, ended = max(root, min(0.1 * GLANCE_S, h)), True
            S_rate, S, S1, S2 = impulse_response(dwell, c, w2)
            x_end, v_end = x + v * dwell + a * S1 + r * S2, s * q[D_V]
    ahead = stop if s * edge >= s * stop else edge
    if s * (x_end - ahead) >= 0.0:
        dwell, ended = stop_time(c, w2, x, v, a, r, ahead, s, 0.0, dwell), True
        _rate, S, S1, _unused = impulse_response(dwell, c, w2)
        x_end, v_end = ahead, (0.0 if ahead == stop else v + a * S + r * S1)
        if ahead != stop and s * v_end < q[D_V]:
            v_end = s * q[D_V]
    return dwell, ended, x_end, v_end, (0.0 if ended else carried), net, more
