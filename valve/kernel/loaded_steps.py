"""Steps of a stem whose slots may not be neutral: how long a sub-step may be, slides, and stays in the band."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.loaded_slip import GLANCE_S
from valve.kernel.loads import coulomb_level, drag_at, extra_static, load, static_level, vibration_rate
from valve.kernel.mode_steps import band_step, slide_end, slip_step
from valve.kernel.slots import D_V, DWELL_RISE, VIBRATION, VIBRATION_RATE, M

EVEN_SHARE: Final = 0.05  # of the speed, by which the stem's swing may still change it where a slide is even
FEATURE_SHARE: Final = 0.1  # of the shortest length over which a slot's force bends, that one sub-step covers
FIRST_FOLLOWED_S: Final = 1.0e-3  # sub-step of a sensor that lags, and of bristles, until the stem is seen to go evenly
MORE_ON_BRISTLES: Final = 3  # steps that one on bristles takes the time of, beside its own
STRAIGHT_M: Final = 2.0e-9  # by which what a lagging sensor follows may be off the chord of a longer one
STRAIGHT_ON_BRISTLES_M: Final = 5.0e-9  # their balance is met at the end of each, whatever the chord


@kernel
def acting_rate(
    q, curves, linear, x, v, t, force, slope, area, net, side, heading, rate, coulomb, static, extra,
    resting, rest_from, never_moved,
):  # fmt: skip
    """Rate of the force that decides between two modes: along the motion, or against the friction that holds it."""
    if not linear and abs(abs(v) - q[D_V]) <= 1.0e-9 * q[D_V]:
        # on the edge of the band all rates along the motion decide
        net_end, more_end, _area = load(q, curves, x + v * GLANCE_S, t + GLANCE_S, force + slope * GLANCE_S)
        gain = net_end - net - heading * (coulomb_level(q, heading, more_end) - coulomb)
        return gain / GLANCE_S + rate * v
    if v == 0.0 and (not linear or q[DWELL_RISE] != 0.0):
        # and where static friction gives way, its own too
        net_end, more_end, _area = load(q, curves, x, t + GLANCE_S, force + slope * GLANCE_S)
        then = extra_static(q, t + GLANCE_S - rest_from, never_moved) if resting else extra
        gain = net_end - net - side * (static_level(q, side, more_end, then) - static)
        return gain / GLANCE_S
    return slope * area + vibration_rate(q, t)


@kernel
def longest_steps(q, linear, rate, longest):
    """Return the longest sub-step where the spring rate is ``rate``, and that for a stem that swings there."""
    most = math.inf if linear else longest
    if q[VIBRATION] != 0.0:
        most = min(most, 0.2 / q[VIBRATION_RATE])
    return most, (1.2 * math.sqrt(q[M] / rate) if rate > 0.0 and not linear else math.inf)


@kernel
def followed_step(follow, dwell, turn, straight, longest):
    """Return the length of the next sub-step after one of ``dwell`` in which the speed changed by ``turn``.

    ``follow`` was allowed. It is doubled where the path stays ``straight`` all the same, and halved where it does not.
    """
    if dwell <= 0.0:
        return follow
    bend = abs(turn) * dwell / 8.0 * (follow / dwell) ** 2
    if bend > straight:
        return max(0.5 * follow, min(FIRST_FOLLOWED_S, longest))
    return min(2.0 * follow, longest) if 4.0 * bend < straight else follow


@kernel
def even_part(left, most):
    """Length of the first of the even parts of ``left`` that are no longer than ``most``: no sliver at the end."""
    return left / math.ceil(left / most - 1.0e-6) if left > most else left


@kernel
def slip_part(q, s, v, slipping, net, coulomb, static, viscous, most, swing, finest, left):
    """Length of one sub-step of ``left`` in motion: at most ``most``, less where it swings or the forces bend."""
    if most > swing:
        # an even slide needs no step as short as the stem's own swing
        gain = abs(net - s * drag_at(q, coulomb, static, v) - viscous * v) * swing
        if not slipping or gain > EVEN_SHARE * q[M] * abs(v):
            most = swing
    if abs(v) * most > FEATURE_SHARE * finest:
        most = FEATURE_SHARE * finest / abs(v)
    return even_part(left, most)


@kernel
def linear_slip(q, s, x, v, net, slope, drag, viscous, rate, low, high, left, memory):
    """Return (time, whether it ended, position, velocity, velocity to begin with) of a slip with neutral slots."""
    DV, a, w2 = q[D_V], (net - s * drag - viscous * v) / q[M], rate / q[M]
    if abs(v) <= DV * (1.0 + 1.0e-12):
        v, a = s * max(abs(v), DV), s * max(s * a, 0.0)
    push = slope / q[M]
    dwell, ended, x_next, v_next = slip_step(
        viscous / q[M], w2, DV, low, high, s, x, v, a, push - w2 * v, push, left, memory
    )
    return dwell, ended, x_next, v_next, v


@kernel
def slide_step(q, curves, linear, s, x, t, force, slope, net, rate, viscous, drag, static, low, high, left):
    """Return (time, whether it ended, position, velocity) of a slide at DV within ``left``."""
    v, along = s * q[D_V], slope
    if not linear and left > 0.0:
        net_end, more_end, _area = load(q, curves, x + v * left, t + left, force + slope * left)
        gain = s * (net_end - net) - static_level(q, s, more_end, 0.0) + static
        along = s * (gain / left + rate * q[D_V])
    return slide_end(rate, viscous, drag, static, q[D_V], low, high, s, x, net, along, left)


@kernel
def loaded_band(
    q, curves, linear, s, x, v, t, force, slope, net, rate, static, beyond, low, high, rounding, left
):  # fmt: skip
    """Return (time, whether it ended, position, velocity, length tried) of a stay in the band within ``left``."""
    along = slope
    while not linear and left > 0.0:
        net_end, more_end, _area = load(q, curves, x, t + left, force + slope * left)
        along = (net_end - net - s * (static_level(q, s, more_end, beyond) - static)) / left
        if s * net - static > rounding or s * (along - rate * v) > 0.0 or left <= GLANCE_S:
            break
        # it has just begun to grow: a chord over less of it says so too
        left *= 0.5
    a, w2 = (net - s * static) / q[M], rate / q[M]
    dwell, ended, x_next, v_next = band_step(
        q[M], w2, static, q[D_V], low, high, s, x, v, a, along / q[M] - w2 * v, net, along, left
    )
    return dwell, ended, x_next, v_next, left
