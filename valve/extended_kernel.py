"""The compiled heart of valve.extended_motion: the Karnopp valve with its slots, one pass over the force's corners.

Between two anchors (a corner, an output, a sub-step of a slip) the linear part of the motion is solved in closed
form, as in valve.motion_kernel, whose kernels serve here too: touch this file whenever that one changes, numba does
not see it. What the slots add is a force that is taken straight in time over the anchor's step, from its value at
the start to that at the predicted end. All slots neutral, nothing is added and the motion is the exact one.

Slots stand in one flat vector ``q`` (SLOTS names its places), curves over travel in the rows of ``curves``, what the
future depends on in ``state`` (STATES). Times in s, lengths in m, forces in N.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve.motion_kernel import (
    FOLLOWED,
    ROOT_NOT_FOUND,
    SLIDE,
    SLIP,
    STOPPED,
    STUCK,
    TOO_MANY_EVENTS,
    band_step,
    impulse_response,
    kernel,
    regime,
    slide_end,
    slip_step,
    stop_time,
)

# The places in q and their neutral values; the parameters themselves have none.
SLOTS: Final = {
    "m": 1.0, "k": 0.0, "F_v": 0.0, "F_c": 0.0, "F_s": 0.0, "DV": 1.0, "F_0": 0.0,
    "low": -math.inf, "high": math.inf, "low_rate": math.inf, "high_rate": math.inf,
    "hardening": 0.0, "knee": 0.0, "knee_rate": 0.0, "flow": 0.0, "flow_decay": 1.0,
    "area_slope": 0.0, "area_reference": 0.0,
    "gradient": 0.0, "gradient_reference": 0.0, "spot": 0.0, "spot_centre": 0.0, "spot_width": 1.0,
    "drift": 0.0, "drift_time": 1.0, "pressure_share": 0.0,
    "coulomb_asymmetry": 0.0, "static_asymmetry": 0.0, "viscous_asymmetry": 0.0,
    "stribeck_velocity": 0.0, "dwell_rise": 0.0, "dwell_time": 1.0, "first_rise": 0.0, "presliding": 0.0,
    "vibration": 0.0, "vibration_rate": 1.0, "vibration_phase": 0.0,
    "position_gain": 1.0, "gain_reference": 0.0, "bow": 0.0, "bow_low": 0.0, "bow_span": 1.0,
    "position_lag": 0.0, "play": 0.0,
    "spring_points": 0.0, "spring_from": 0.0, "spring_to": 1.0,
    "area_points": 0.0, "area_from": 0.0, "area_to": 1.0,
    "friction_points": 0.0, "friction_from": 0.0, "friction_to": 1.0,
}  # fmt: skip
(
    M, K, F_V, F_C, F_S, D_V, F_0,
    LOW, HIGH, LOW_RATE, HIGH_RATE,
    HARDENING, KNEE, KNEE_RATE, FLOW, FLOW_DECAY,
    AREA_SLOPE, AREA_REFERENCE,
    GRADIENT, GRADIENT_REFERENCE, SPOT, SPOT_CENTRE, SPOT_WIDTH,
    DRIFT, DRIFT_TIME, PRESSURE_SHARE,
    COULOMB_ASYMMETRY, STATIC_ASYMMETRY, VISCOUS_ASYMMETRY,
    STRIBECK, DWELL_RISE, DWELL_TIME, FIRST_RISE, PRESLIDING,
    VIBRATION, VIBRATION_RATE, VIBRATION_PHASE,
    GAIN, GAIN_REFERENCE, BOW, BOW_LOW, BOW_SPAN,
    POSITION_LAG, PLAY,
    SPRING_POINTS, SPRING_FROM, SPRING_TO,
    AREA_POINTS, AREA_FROM, AREA_TO,
    FRICTION_POINTS, FRICTION_FROM, FRICTION_TO,
) = range(len(SLOTS))  # fmt: skip
SPRING_CURVE, AREA_CURVE, FRICTION_CURVE = range(3)

# What the future depends on. REST_SINCE and ELAPSED are times of the slots' own clock; BRISTLE, PLAYED and LAGGED
# may be NaN: not loaded yet, nothing shown yet.
STATES: Final = (
    "x", "v", "mode", "elapsed", "rest_since", "never_moved", "bristle", "extra_static", "played", "shown", "lagged",
)  # fmt: skip
(
    AT_X, AT_V, IN_MODE, ELAPSED, REST_SINCE, NEVER_MOVED, BRISTLE, EXTRA, PLAYED, SHOWN, LAGGED,
) = range(len(STATES))  # fmt: skip

BREAK_MARGIN: Final = 0.02  # the bristles' asymptote lies so far above F_s that F_s is met at a finite deflection
STRIBECK_SHARE: Final = 0.15  # of v_s, by which the speed changes in one sub-step
FEATURE_SHARE: Final = 0.1  # of the shortest length over which a slot's force bends, that one sub-step covers
EVEN_SHARE: Final = 0.05  # of the speed, by which the stem's swing may still change it where a slide is even
SPEED_DEFECT_M_PER_S: Final = 2.0e-4  # by which the slots may correct a sub-step's speed; else it is halved
SHORTEST_CUT_S: Final = 2.0e-5
LONGEST_FOLLOWED_S: Final = 1.0e-3  # sub-step of a sensor that lags or has play, and of bristles
GLANCE_S: Final = 1.0e-6
MOST_STEPS: Final = 100_000
MOST_ATTEMPTS: Final = 100  # to find a sub-step's length
SHORTEST_STEP_S: Final = 1.0e-9


@kernel
def curve_value(curves, row, points, start, end, x):
    """Value of one curve at x: cubic through evenly spaced points (Catmull-Rom), held beyond its ends."""
    n, y = int(points), curves[row]
    if x <= start:
        return y[0]
    if x >= end:
        return y[n - 1]
    u = (x - start) / (end - start) * (n - 1)
    i = min(int(u), n - 2)
    u -= i
    rise = y[i + 1] - y[i]
    before = 0.5 * (y[i + 1] - y[i - 1]) if i > 0 else rise
    after = 0.5 * (y[i + 2] - y[i]) if i + 2 < n else rise
    return y[i] + u * (before + u * (3.0 * rise - 2.0 * before - after + u * (before + after - 2.0 * rise)))


@kernel
def load(q, curves, x, t, force):
    """Return net force on a stem at rest, friction that place, time and force add, and relative effective area."""
    area = 1.0
    if q[AREA_SLOPE] != 0.0:
        area += q[AREA_SLOPE] * (x - q[AREA_REFERENCE])
    if q[AREA_POINTS] > 0.0:
        area += curve_value(curves, AREA_CURVE, q[AREA_POINTS], q[AREA_FROM], q[AREA_TO], x)
    net = force * area - q[K] * x - q[F_0]
    if q[HARDENING] != 0.0:
        net -= 0.5 * q[HARDENING] * x * x
    if q[KNEE_RATE] != 0.0 and x > q[KNEE]:
        net -= q[KNEE_RATE] * (x - q[KNEE])
    if q[FLOW] != 0.0:
        net += q[FLOW] * math.exp(-max(x, 0.0) / q[FLOW_DECAY])
    if q[SPRING_POINTS] > 0.0:
        net -= curve_value(curves, SPRING_CURVE, q[SPRING_POINTS], q[SPRING_FROM], q[SPRING_TO], x)
    if x < q[LOW] and q[LOW_RATE] < math.inf:
        net -= q[LOW_RATE] * (x - q[LOW])
    if x > q[HIGH] and q[HIGH_RATE] < math.inf:
        net -= q[HIGH_RATE] * (x - q[HIGH])
    if q[VIBRATION] != 0.0:
        net += q[VIBRATION] * math.sin(q[VIBRATION_RATE] * t + q[VIBRATION_PHASE])
    more = 0.0
    if q[GRADIENT] != 0.0:
        more += q[GRADIENT] * (x - q[GRADIENT_REFERENCE])
    if q[SPOT] != 0.0:
        u = (x - q[SPOT_CENTRE]) / q[SPOT_WIDTH]
        more += q[SPOT] * math.exp(-0.5 * u * u)
    if q[FRICTION_POINTS] > 0.0:
        more += curve_value(curves, FRICTION_CURVE, q[FRICTION_POINTS], q[FRICTION_FROM], q[FRICTION_TO], x)
    if q[DRIFT] != 0.0:
        more += q[DRIFT] * (1.0 - math.exp(-t / q[DRIFT_TIME]))
    if q[PRESSURE_SHARE] != 0.0:
        more += q[PRESSURE_SHARE] * abs(force)
    return net, more, area


@kernel
def vibration_rate(q, t):
    """Rate at which the vibration's force changes, N/s."""
    if q[VIBRATION] == 0.0:
        return 0.0
    return q[VIBRATION] * q[VIBRATION_RATE] * math.cos(q[VIBRATION_RATE] * t + q[VIBRATION_PHASE])


@kernel
def coulomb_level(q, s, more):
    """Coulomb friction in the direction s, never below 0."""
    return max((q[F_C] + more) * (1.0 + s * q[COULOMB_ASYMMETRY]), 0.0)


@kernel
def static_level(q, s, more, extra):
    """Static friction in the direction s, never below the Coulomb friction there."""
    return max((q[F_S] + more + extra) * (1.0 + s * q[STATIC_ASYMMETRY]), coulomb_level(q, s, more))


@kernel
def extra_static(q, rested, never_moved):
    """Static friction that a rest of this length adds, and the first breakaway of all."""
    extra = 0.0
    if q[DWELL_RISE] != 0.0:
        extra = q[DWELL_RISE] * max(rested, 0.0) / (max(rested, 0.0) + q[DWELL_TIME])
    if never_moved:
        extra += q[FIRST_RISE]
    return extra


@kernel
def drag_at(q, coulomb, static, v):
    """Friction at a speed without its viscous part: Coulomb and Stribeck."""
    if q[STRIBECK] > 0.0:
        u = v / q[STRIBECK]
        return coulomb + (static - coulomb) * math.exp(-u * u)
    return coulomb


@kernel
def zone(q, x, heading):
    """Spring rate of the straight piece that lies ahead of x, and the next place where it changes."""
    rate, edge = q[K], heading * math.inf
    if q[KNEE_RATE] != 0.0:
        p = q[KNEE]
        if x > p or (x == p and heading > 0.0):
            rate += q[KNEE_RATE]
        if heading * (p - x) > 0.0:
            edge = p
    if q[HIGH_RATE] < math.inf and q[HIGH] < math.inf:
        p = q[HIGH]
        if x > p or (x == p and heading > 0.0):
            rate += q[HIGH_RATE]
        if heading * (p - x) > 0.0 and heading * (p - edge) < 0.0:
            edge = p
    if q[LOW_RATE] < math.inf and q[LOW] > -math.inf:
        p = q[LOW]
        if x < p or (x == p and heading < 0.0):
            rate += q[LOW_RATE]
        if heading * (p - x) > 0.0 and heading * (p - edge) < 0.0:
            edge = p
    return rate, edge


@kernel
def is_neutral_in_motion(q):
    """Whether a slip obeys one linear equation a direction: nothing is added to it over time and travel."""
    return (
        q[HARDENING] == 0.0 and q[KNEE_RATE] == 0.0 and q[FLOW] == 0.0 and q[AREA_SLOPE] == 0.0
        and q[GRADIENT] == 0.0 and q[SPOT] == 0.0 and q[DRIFT] == 0.0 and q[PRESSURE_SHARE] == 0.0
        and q[STRIBECK] == 0.0 and q[VIBRATION] == 0.0
        and q[SPRING_POINTS] == 0.0 and q[AREA_POINTS] == 0.0 and q[FRICTION_POINTS] == 0.0
        and (q[LOW_RATE] == math.inf or q[LOW] == -math.inf) and (q[HIGH_RATE] == math.inf or q[HIGH] == math.inf)
    )  # fmt: skip


@kernel
def finest_feature(q):
    """Shortest length over which a slot's force bends, m; infinite where none does."""
    finest = math.inf
    if q[SPOT] != 0.0:
        finest = min(finest, q[SPOT_WIDTH])
    if q[FLOW] != 0.0:
        finest = min(finest, q[FLOW_DECAY])
    for points, start, end in (
        (q[SPRING_POINTS], q[SPRING_FROM], q[SPRING_TO]),
        (q[AREA_POINTS], q[AREA_FROM], q[AREA_TO]),
        (q[FRICTION_POINTS], q[FRICTION_FROM], q[FRICTION_TO]),
    ):
        if points > 0.0:
            finest = min(finest, (end - start) / max(points - 1.0, 1.0))
    return finest


@kernel
def turning_time(c, w2, a, r, late):
    """Time in [0, late] at which the acceleration passes zero; it does so once there."""
    lo, hi, tau = 0.0, late, 0.5 * late
    for _ in range(100):
        rate, S, S1, _unused = impulse_response(tau, c, w2)
        now = a * rate + r * S
        if now * a > 0.0:
            lo = tau
        else:
            hi = tau
        jerk = r - w2 * (a * S + r * S1) - c * now
        guess = tau - now / jerk if jerk != 0.0 else math.inf
        if not lo < guess < hi:
            guess = 0.5 * (lo + hi)
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
        if over > 0.0:
            lo = tau
        else:
            hi = tau
        now = s * (a * rate + r * S)
        guess = tau - over / now if now != 0.0 else math.inf
        if not lo < guess < hi:
            guess = 0.5 * (lo + hi)
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
    over, starting = 0.0, abs(v) <= q[D_V] * (1.0 + 1.0e-9) and s * a <= 0.0
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
            more_rate = q[DRIFT] / q[DRIFT_TIME] * math.exp(-(t + tau) / q[DRIFT_TIME])
            more_bend = abs(more_rate) / q[DRIFT_TIME]
        if q[PRESSURE_SHARE] != 0.0:
            now = force + slope * tau
            more_rate += q[PRESSURE_SHARE] * slope * (1.0 if now > 0.0 or (now == 0.0 and slope > 0.0) else -1.0)
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


@kernel
def bristle_force(asymptote, stiffness, side, loaded, d):
    """Dahl's force after a way d >= 0 towards ``side`` from where it was ``loaded``."""
    return side * (asymptote - (asymptote - side * loaded) * math.exp(-stiffness * d / asymptote))


@kernel
def bristle_way(q, curves, x, loaded, side, t, force, asymptote, stiffness, weight, drive):
    """Way d >= 0 towards ``side`` with F_v d = drive + weight (net - Dahl's force), and what drives there."""
    viscous, d, excess = q[F_V] * (1.0 + side * q[VISCOUS_ASYMMETRY]), 0.0, 0.0
    for _ in range(60):
        held = bristle_force(asymptote, stiffness, side, loaded, d)
        net, _more, _area = load(q, curves, x + side * d, t, force)
        excess = side * (net - held)
        rate, _edge = zone(q, x + side * d, side)
        missing = drive + weight * excess - viscous * d
        # concave and rising from below: Newton never leaps over the balance
        step = missing / (viscous + weight * (rate + stiffness * max(1.0 - side * held / asymptote, 0.0)))
        step = max(step, -d)
        d += step
        # squared by the convergence, what is left is below rounding
        if abs(step) <= 1.0e-15 + 1.0e-7 * d:
            break
    return d, excess


@kernel
def bristle_step(q, curves, x, loaded, t, force, slope, rested, never_moved, h):
    """Return (side, way, way at which the bristles give way, asymptote, drive at the end) of an elastic rest after h.

    F_v x' = net - Dahl's force, without inertia; the two-stage, L-stable SDIRK of order 2.
    """
    stiffness, part = max(q[F_S], 1.0e-6) / q[PRESLIDING], 1.0 - math.sqrt(0.5)
    last = force + slope * h
    net, more, _area = load(q, curves, x, t + h, last)
    side = 1.0 if net > loaded else -1.0
    static = max(static_level(q, side, more, extra_static(q, rested + h, never_moved)), 1.0e-9)
    asymptote = static / (1.0 - BREAK_MARGIN)
    until = asymptote / stiffness * math.log(max(asymptote - side * loaded, 1.0e-300) / (asymptote - static))
    _d, early = bristle_way(
        q, curves, x, loaded, side, t + part * h, force + slope * part * h, asymptote, stiffness, part * h, 0.0
    )
    early = max(early, 0.0) if q[F_V] > 0.0 else 0.0
    weight = part * h if h > 0.0 else 1.0
    d, excess = bristle_way(
        q, curves, x, loaded, side, t + h, last, asymptote, stiffness, weight, (1.0 - part) * h * early
    )
    return side, d, max(until, 0.0), asymptote, excess


@kernel
def bristle_rest(q, curves, x, loaded, t, force, slope, rested, never_moved, left):
    """Return (time, whether it gave way, position, velocity, bristle force) of an elastic rest within ``left``.

    The bristles (Dahl 1968, exponent 1) and the viscous friction carry what spring and actuator do not, until the
    bristles carry F_s.
    """
    stiffness = max(q[F_S], 1.0e-6) / q[PRESLIDING]
    side, d, until, asymptote, excess = bristle_step(q, curves, x, loaded, t, force, slope, rested, never_moved, left)
    if d < until or (d - until <= 1.0e-12 and excess <= 1.0e-9 * asymptote):
        return left, False, x + side * d, 0.0, bristle_force(asymptote, stiffness, side, loaded, d)
    lo, hi, under, over, tau = 0.0, left, -until, d - until, left
    for _ in range(60):
        tau = lo - under * (hi - lo) / (over - under) if over > under else 0.5 * (lo + hi)
        if not lo < tau < hi:
            tau = 0.5 * (lo + hi)
        side, d, until, asymptote, excess = bristle_step(
            q, curves, x, loaded, t, force, slope, rested, never_moved, tau
        )
        if abs(d - until) <= 1.0e-13 or hi - lo <= 1.0e-13:
            break
        # Illinois: the value at the end that stays is halved, so that both ends move
        if d >= until:
            hi, over, under = tau, d - until, 0.5 * under
        else:
            lo, under, over = tau, d - until, 0.5 * over
    at, viscous = x + side * until, q[F_V] * (1.0 + side * q[VISCOUS_ASYMMETRY])
    rate, _edge = zone(q, at, side)
    _net, _more, area = load(q, curves, at, t + tau, force + slope * tau)
    speed = side * (slope * area + vibration_rate(q, t + tau)) / (rate + stiffness * BREAK_MARGIN)
    if viscous > 0.0:
        speed = excess / viscous
    return tau, True, at, side * max(speed, 0.0), math.nan


@kernel
def displayed(q, played):
    """Position that a sensor with its gain and bow makes of what its lever follows."""
    y = played
    if q[BOW] != 0.0:
        u = (y - q[BOW_LOW]) / q[BOW_SPAN]
        y += 4.0 * q[BOW] * u * (1.0 - u)
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
def follow_extended(
    q, curves, state, corner_time, corner_force, end_time, out_time, rest_time, rest_x, rest_since,
    out_x, out_sensed, out_v, out_mode, out_force, event_time, event_mode, most_events, longest,
):  # fmt: skip
    """Follow the stem from the first corner to ``end_time``, ``state`` in place; return (status, events, passes).

    Corners and outputs as in valve.motion_kernel.follow; all five outputs are written. At each of ``rest_time``
    (rising) the stem is put to rest at ``rest_x``, where it rests since ``rest_since``. ``longest`` bounds the
    sub-steps of a slip whose slots are not neutral, and of a stem whose bristles give. ``passes`` is the number of
    steps that it took, the measure of its work.
    """
    m, DV = q[M], q[D_V]
    x, v, mode, extra = state[AT_X], state[AT_V], int(state[IN_MODE]), state[EXTRA]
    never_moved, rest_from, bristle = state[NEVER_MOVED] != 0.0, state[REST_SINCE], state[BRISTLE]
    clock = state[ELAPSED] - corner_time[0]  # from the corners' times to the slots' own
    low = q[LOW] if q[LOW_RATE] == math.inf else -math.inf
    high = q[HIGH] if q[HIGH_RATE] == math.inf else math.inf
    linear, finest, elastic = is_neutral_in_motion(q), finest_feature(q), q[PRESLIDING] > 0.0
    following = q[POSITION_LAG] > 0.0 or q[PLAY] > 0.0
    sensing = following or q[GAIN] != 1.0 or q[BOW] != 0.0
    if sensing and math.isnan(state[PLAYED]):
        state[PLAYED], state[SHOWN] = x, displayed(q, x)
        state[LAGGED] = state[SHOWN]
    rising, falling, response = np.full(5, math.nan), np.full(5, math.nan), np.full(7, math.nan)
    n, n_out, n_rest = corner_time.size, out_time.size, rest_time.size
    n_events, out, put, pieces, passes, carried, elastic_v = 0, 0, 0, 0, 0, 0.0, 0.0
    net, more, area, s, beyond, static = 0.0, 0.0, 1.0, 1.0, 0.0, 0.0
    viscous, coulomb, highest, drag, rounding = 0.0, 0.0, 0.0, 0.0, 0.0
    rate_before, most_there, swing, stalls = math.nan, math.inf, math.inf, 0
    rate, edge, held_force, fresh, loaded = q[K], math.inf, corner_force[0], True, False
    if mode == STUCK and v == 0.0 and (x >= high or x <= low):
        mode = STOPPED
    for i in range(n):
        start, last = corner_time[i], i == n - 1
        if start > end_time:
            break
        stop = end_time if last else min(corner_time[i + 1], end_time)
        fresh = fresh or (i > 0 and corner_time[i - 1] == start)
        if stop == start:
            # of a step only the far side counts, and at the very end only where there was a step
            if (not last and corner_time[i + 1] == start) or i == 0 or corner_time[i - 1] < start:
                continue
            slope = 0.0
        else:
            slope = 0.0 if last else (corner_force[i + 1] - corner_force[i]) / (corner_time[i + 1] - start)
        # tau is kept beside the time: their difference would be rounded, and times a steep slope that is a force
        now_s, tau, going = start, 0.0, True
        while going:
            passes += 1
            force, t = corner_force[i] + slope * tau, now_s + clock
            if put < n_rest and rest_time[put] <= now_s:
                while put + 1 < n_rest and rest_time[put + 1] <= now_s:
                    put += 1
                x, v, extra, bristle = min(max(rest_x[put], low), high), 0.0, 0.0, math.nan
                if mode not in (STUCK, STOPPED):
                    mode = STUCK
                rest_from = rest_since[put] + clock
                put += 1
                fresh = True
                if sensing:
                    sense(q, state, x, 0.0)
            coasting = not fresh and mode == SLIP and abs(v) > DV * (1.0 + 1.0e-12)
            if fresh or coasting or elastic or mode != STUCK:
                if x >= high:
                    x, v = high, min(v, 0.0)
                elif x <= low:
                    x, v = low, max(v, 0.0)
                if not (coasting and loaded):
                    net, more, area = load(q, curves, x, t, force)
                side = 1.0 if net > 0.0 else -1.0
                heading = side if v == 0.0 else (1.0 if v > 0.0 else -1.0)
                viscous, coulomb = q[F_V] * (1.0 + heading * q[VISCOUS_ASYMMETRY]), coulomb_level(q, heading, more)
                highest = static_level(q, heading, more, 0.0) if q[STRIBECK] > 0.0 else coulomb
                drag, s = drag_at(q, coulomb, highest, DV), heading
                rate, edge = zone(q, x, heading)
                if not coasting:
                    resting = mode in (STUCK, STOPPED)
                    beyond = extra_static(q, t - rest_from, never_moved) if resting else extra
                    static = static_level(q, side, more, beyond)
                    # of the numbers that make up the net force, and of the time at which it is taken
                    numbers = abs(force) + abs(q[K] * x) + abs(q[F_0]) + tau * (abs(slope) + q[K] * abs(v))
                    rounding = 1.0e-15 * numbers
                    if not linear or elastic:
                        rounding += 1.0e-9 * static
                    if mode == STUCK and elastic and abs(bristle) < static:
                        now = STUCK
                    else:
                        push = slope * area + vibration_rate(q, t)
                        if not linear and abs(abs(v) - DV) <= 1.0e-9 * DV:
                            # on the edge of the band all rates along the motion decide
                            net_end, more_end, _area = load(
                                q, curves, x + v * GLANCE_S, t + GLANCE_S, force + slope * GLANCE_S
                            )
                            gain = net_end - net - heading * (coulomb_level(q, heading, more_end) - coulomb)
                            push = gain / GLANCE_S + rate * v
                        elif v == 0.0 and (not linear or q[DWELL_RISE] != 0.0):
                            # and where static friction gives way, its own too
                            net_end, more_end, _area = load(q, curves, x, t + GLANCE_S, force + slope * GLANCE_S)
                            then = extra_static(q, t + GLANCE_S - rest_from, never_moved) if resting else extra
                            gain = net_end - net - side * (static_level(q, side, more_end, then) - static)
                            push = gain / GLANCE_S
                        now, s = regime(rate, viscous, drag, static, DV, low, high, x, v, net, push, rounding)
                    if (n_events == most_events and now != mode) or pieces > most_events:
                        state[AT_X], state[AT_V], state[IN_MODE] = x, v, mode
                        return TOO_MANY_EVENTS, n_events, passes
                    if now != mode:
                        carried = 0.0
                        if now in (STUCK, STOPPED):
                            if not resting:
                                rest_from = t
                                # a slip leaves the bristles bent its own way
                                bristle = heading * coulomb if mode in (SLIP, SLIDE) else net
                        elif resting:
                            extra = beyond
                        mode = now
                        if n_events < event_time.size:
                            event_time[n_events], event_mode[n_events] = now_s, mode
                        n_events += 1
                    if mode in (SLIP, SLIDE):
                        extra, never_moved = 0.0, False
                    elif mode in (STUCK, STOPPED):
                        v = 0.0
                        if math.isnan(bristle):
                            bristle = net
            yielding = mode == STUCK and elastic
            held = mode in (STUCK, STOPPED) and not yielding
            while out < n_out and out_time[out] <= now_s:
                out = sampled(
                    out, x, state[LAGGED] if sensing else x, elastic_v if yielding else v, mode, force,
                    out_x, out_sensed, out_v, out_mode, out_force,
                )  # fmt: skip
            until = stop
            if put < n_rest:
                until = min(until, rest_time[put])
            if q[PRESSURE_SHARE] != 0.0 and force * slope < 0.0 and now_s - force / slope > now_s:
                until = min(until, now_s - force / slope)
            if out < n_out and not held:
                until = min(until, out_time[out])
            left, ended, x_next, v_next, loaded = until - now_s, False, x, 0.0, False
            dwell = left
            if held:
                away = s if mode == STOPPED else 0.0
                dwell, ended = rest_length(q, curves, x, t, force, slope, t - rest_from, never_moved, away, left)
            elif yielding:
                most = min(longest, LONGEST_FOLLOWED_S)
                if q[VIBRATION] != 0.0:
                    most = min(most, 0.1 / q[VIBRATION_RATE])
                if left > most:
                    left /= math.ceil(left / most - 1.0e-6)
                dwell, ended, x_next, v_next, bristle = bristle_rest(
                    q, curves, x, bristle, t, force, slope, t - rest_from, never_moved, left
                )
                elastic_v = (x_next - x) / dwell if dwell > 0.0 else 0.0
            else:
                if rate != rate_before:
                    rate_before, most_there = rate, (math.inf if linear else longest)
                    if following:
                        most_there = min(most_there, LONGEST_FOLLOWED_S)
                    if q[VIBRATION] != 0.0:
                        most_there = min(most_there, 0.2 / q[VIBRATION_RATE])
                    swing = 1.2 * math.sqrt(m / rate) if rate > 0.0 and not linear else math.inf
                most = most_there
                if most > swing:
                    now_drag = drag_at(q, coulomb, highest, v)
                    # an even slide needs no step as short as the stem's own swing
                    if mode != SLIP or abs(net - s * now_drag - viscous * v) * swing > EVEN_SHARE * m * abs(v):
                        most = swing
                if abs(v) * most > FEATURE_SHARE * finest:
                    most = FEATURE_SHARE * finest / abs(v)
                if left > most:
                    # even parts: no sliver is left at the end
                    left /= math.ceil(left / most - 1.0e-6)
                if left <= 0.0 and mode == SLIP and not linear:
                    # a step at the very end: only what the stem is in is told anew
                    dwell, ended, x_next, v_next = 0.0, False, x, v
                elif mode == SLIP and not linear:
                    dwell, ended, x_next, v_next, carried, net, more = loaded_slip(
                        q, curves, s, x, v, t, force, slope, left, rate, edge, low, high,
                        net, coulomb, highest, viscous, carried, response,
                    )  # fmt: skip
                    left, loaded = dwell, not ended
                elif mode == SLIP:
                    a, w2 = (net - s * drag - viscous * v) / m, rate / m
                    if abs(v) <= DV * (1.0 + 1.0e-12):
                        v, a = s * max(abs(v), DV), s * max(s * a, 0.0)
                    dwell, ended, x_next, v_next = slip_step(
                        viscous / m, w2, DV, low, high, s, x, v, a, slope / m - w2 * v, slope / m, left,
                        rising if s > 0.0 else falling,
                    )  # fmt: skip
                    if math.isnan(dwell):
                        state[AT_X], state[AT_V], state[IN_MODE] = x, v, mode
                        return ROOT_NOT_FOUND, n_events, passes
                elif mode == SLIDE:
                    v, along = s * DV, slope
                    if not linear and left > 0.0:
                        net_end, more_end, _area = load(q, curves, x + s * DV * left, t + left, force + slope * left)
                        gain = s * (net_end - net) - static_level(q, s, more_end, 0.0) + static
                        along = s * (gain / left + rate * DV)
                    dwell, ended, x_next, v_next = slide_end(
                        rate, viscous, drag, static, DV, low, high, s, x, net, along, left
                    )
                else:
                    along = slope
                    while not linear and left > 0.0:
                        net_end, more_end, _area = load(q, curves, x, t + left, force + slope * left)
                        along = (net_end - net - s * (static_level(q, s, more_end, beyond) - static)) / left
                        if s * net - static > rounding or s * (along - rate * v) > 0.0 or left <= GLANCE_S:
                            break
                        # it has just begun to grow: a chord over less of it says so too
                        left *= 0.5
                    a, w2 = (net - s * static) / m, rate / m
                    dwell, ended, x_next, v_next = band_step(
                        m, w2, static, DV, low, high, s, x, v, a, along / m - w2 * v, net, along, left
                    )
            pieces += ended
            fresh = ended
            # where two modes touch, each may hand over to the other for ever: time goes on all the same
            stalls = stalls + 1 if (ended or left < until - now_s) and dwell < 1.0e-12 else 0
            if stalls > 2:
                pieces += 1
                fresh, left = True, min(until - now_s, 0.1 * GLANCE_S)
                dwell = left
            if ended or left < until - now_s:
                tau += dwell
                after_s = start + tau
            else:
                tau, after_s = until - start, until
            if held:
                while out < n_out and out_time[out] < after_s:
                    settled = state[SHOWN] if sensing else x
                    if q[POSITION_LAG] > 0.0:
                        settled += (state[LAGGED] - settled) * math.exp((now_s - out_time[out]) / q[POSITION_LAG])
                    out = sampled(
                        out, x, settled, 0.0, mode, corner_force[i] + slope * (out_time[out] - start),
                        out_x, out_sensed, out_v, out_mode, out_force,
                    )  # fmt: skip
            if sensing:
                sense(q, state, x_next, after_s - now_s)
            x, v, now_s = x_next, v_next, after_s
            going = ended or now_s < stop
        held_force = corner_force[i] + slope * (stop - start)
    while out < n_out:
        out = sampled(
            out, x, state[LAGGED] if sensing else x, elastic_v if elastic and mode == STUCK else v, mode, held_force,
            out_x, out_sensed, out_v, out_mode, out_force,
        )  # fmt: skip
    state[AT_X], state[AT_V], state[IN_MODE], state[EXTRA] = x, v, mode, extra
    state[ELAPSED], state[REST_SINCE], state[BRISTLE] = clock + end_time, rest_from, bristle
    state[NEVER_MOVED] = 1.0 if never_moved else 0.0
    return FOLLOWED, n_events, passes
