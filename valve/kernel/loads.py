"""Forces that the slots add: over travel, time, force and speed, and the places where their rates change."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math

from valve.kernel.compiled import kernel
from valve.kernel.slots import (
    AREA_CURVE,
    AREA_FROM,
    AREA_POINTS,
    AREA_REFERENCE,
    AREA_SLOPE,
    AREA_TO,
    COULOMB_ASYMMETRY,
    DRIFT,
    DRIFT_TIME,
    DWELL_RISE,
    DWELL_TIME,
    F_0,
    F_C,
    F_S,
    FIRST_RISE,
    FLOW,
    FLOW_DECAY,
    FRICTION_CURVE,
    FRICTION_FROM,
    FRICTION_POINTS,
    FRICTION_TO,
    GRADIENT,
    GRADIENT_BEND,
    GRADIENT_REFERENCE,
    HARDENING,
    HARDENING_BEND,
    HARDENING_MIDDLE,
    HIGH,
    HIGH_RATE,
    KNEE,
    KNEE_RATE,
    LOW,
    LOW_RATE,
    PRESSURE_SHARE,
    SPOT,
    SPOT_CENTRE,
    SPOT_WIDTH,
    SPRING_CURVE,
    SPRING_FROM,
    SPRING_POINTS,
    SPRING_TO,
    STATIC_ASYMMETRY,
    STATIC_SHARE,
    STRIBECK,
    VIBRATION,
    VIBRATION_PHASE,
    VIBRATION_RATE,
    K,
)


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
    if q[HARDENING_BEND] != 0.0:
        net -= 0.5 * q[HARDENING_BEND] * x * x * (x / 3.0 - q[HARDENING_MIDDLE])
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
    if q[GRADIENT_BEND] != 0.0:
        more += q[GRADIENT_BEND] * (x - q[GRADIENT_REFERENCE]) ** 2
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
    return max((q[F_S] + q[STATIC_SHARE] * more + extra) * (1.0 + s * q[STATIC_ASYMMETRY]), coulomb_level(q, s, more))


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
        q[HARDENING] == 0.0 and q[HARDENING_BEND] == 0.0 and q[KNEE_RATE] == 0.0 and q[FLOW] == 0.0
        and q[AREA_SLOPE] == 0.0 and q[GRADIENT] == 0.0 and q[GRADIENT_BEND] == 0.0 and q[SPOT] == 0.0
        and q[DRIFT] == 0.0 and q[PRESSURE_SHARE] == 0.0
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
