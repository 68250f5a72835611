"""One small step of a stem with a packing: of its slip, its bristles, its clocks and its sensor."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Final

from simulator.kernel.compiled import kernel
from simulator.kernel.packed_friction import breakaway_level, draw_breakaway, excess, forces, turn_load
from simulator.kernel.packed_state import (
    AGE,
    BAND,
    DOWN_LOW,
    FILTERED,
    KNOT_S,
    P_FILTER,
    P_WANDER,
    RECORD_TIME,
    SINCE_KNOT,
    SLIP,
    SLIPPED,
    STILL_SINCE,
    STUCK,
    UP_LOW,
    WANDER_FROM,
    WANDER_INTEGRAL,
    WANDER_SQUARES,
    WANDER_TO,
)
from valve.kernel.loads import coulomb_level, drag_at
from valve.kernel.sensing import sense
from valve.kernel.slots import (
    AT_V,
    AT_X,
    BRISTLE,
    D_V,
    ELAPSED,
    EXTRA,
    F_S,
    F_V,
    HIGH,
    HIGH_RATE,
    IN_MODE,
    LAGGED,
    LOW,
    LOW_RATE,
    POSITION_LAG,
    PRESLIDING,
    REST_SINCE,
    SHOWN,
    STRIBECK,
    VISCOUS_ASYMMETRY,
    K,
    M,
)

_CUTS: Final = 6  # secant steps to a cut inside a step


@kernel
def pass_time(p, state, dt):
    """Let the clocks of a stem go on."""
    state[ELAPSED] += dt
    state[AGE] += dt
    state[RECORD_TIME] += dt
    if p[P_WANDER] > 0.0:
        slope = (state[WANDER_TO] - state[WANDER_FROM]) / KNOT_S
        middle = state[WANDER_FROM] + slope * (state[SINCE_KNOT] + 0.5 * dt)
        state[WANDER_INTEGRAL] += middle * dt
        state[WANDER_SQUARES] += middle * middle * dt
        state[SINCE_KNOT] += dt


@kernel
def follow_sensor(q, p, state, x, dt, keep):
    """Let the sensor and its filter follow a stem that went straight to x in ``dt``; ``keep`` is exp(-dt/filter)."""
    shown = state[LAGGED]
    sense(q, state, x, dt)
    if p[P_FILTER] == 0.0:
        state[FILTERED] = state[LAGGED]
    elif dt > 0.0:
        way = (state[LAGGED] - shown) / dt * p[P_FILTER]
        state[FILTERED] = state[LAGGED] - way + (state[FILTERED] - shown + way) * keep


@kernel
def sensor_is_settled(q, p, state):
    """Whether what a sensor shows of a stem at rest is what it will show."""
    return not (
        (p[P_FILTER] > 0.0 and abs(state[FILTERED] - state[LAGGED]) > 1.0e-12)
        or (q[POSITION_LAG] > 0.0 and abs(state[LAGGED] - state[SHOWN]) > 1.0e-12)
    )


@kernel
def come_to_rest(state, seed):
    """Put the stem to rest; after a slip the next breakaway is drawn."""
    if state[SLIPPED] > 0.0:
        state[SLIPPED] = 0.0
        draw_breakaway(state, seed, 0.0)
    state[AT_V], state[IN_MODE], state[EXTRA] = 0.0, STUCK, 0.0
    state[REST_SINCE], state[STILL_SINCE], state[BRISTLE] = state[ELAPSED], state[AGE], math.nan


@kernel
def count_way(state, x):
    """Count the step to x in what the record has swept in its direction."""
    before = state[AT_X]
    first = UP_LOW if x > before else DOWN_LOW
    state[first] = min(state[first], before, x)
    state[first + 1] = max(state[first + 1], before, x)


@kernel
def slip_step(q, curves, p, table, state, s, force, slope, h, decay):
    """Return position and velocity of a slip after h; ``decay`` is exp(-c h).

    Force and friction at the step's middle, c = F_v/m exactly.
    """
    x, v = state[AT_X], state[AT_V]
    net, more, up, down = forces(q, curves, p, table, state, x + 0.5 * h * v, 0.5 * h, force + 0.5 * h * slope)
    added = up if s > 0.0 else down
    coulomb = coulomb_level(q, s, more + added)
    level = breakaway_level(q, p, state, s, more, added, 0.0)
    c = q[F_V] * (1.0 + s * q[VISCOUS_ASYMMETRY]) / q[M]
    a = (net - s * drag_at(q, coulomb, level, v)) / q[M]
    if q[STRIBECK] > 0.0:
        # friction that falls with speed is taken at the middle too
        for _ in range(3):
            middle_v = v + 0.5 * h * (a - c * v) / (1.0 + 0.5 * c * h)
            a = (net - s * drag_at(q, coulomb, level, middle_v)) / q[M]
    if c * h < 1.0e-4:
        run, fall = h * (1.0 - 0.5 * c * h), 0.5 * h * h * (1.0 - c * h / 3.0)
    else:
        run = (1.0 - decay) / c
        fall = (h - run) / c
    return x + v * run + a * fall, v * (1.0 - c * run) + a * run


@kernel
def bristle_step(q, curves, p, table, seed, state, force, slope, h):
    """Let a stem on Dahl's bristles yield for h, without inertia; say whether they give way, where and how fast."""
    x, loaded = state[AT_X], state[BRISTLE]
    net, more, up, down = forces(q, curves, p, table, state, x, h, force + h * slope)
    if math.isnan(loaded):
        state[BRISTLE] = net
        return False, x, 0.0
    turn_load(state, seed, 1.0 if net > 0.0 else -1.0)
    side = 1.0 if net > loaded else -1.0
    level = max(breakaway_level(q, p, state, side, more, up if side > 0.0 else down, h), 1.0e-9)
    asymptote, stiffness = level / 0.98, max(q[F_S], 1.0e-6) / q[PRESLIDING]
    give = stiffness * max(1.0 - side * loaded / asymptote, 0.0)
    way = (net - loaded) / (q[F_V] * (1.0 + side * q[VISCOUS_ASYMMETRY]) / h + q[K] + give)
    state[BRISTLE] = side * (asymptote - (asymptote - side * loaded) * math.exp(-stiffness * abs(way) / asymptote))
    return side * state[BRISTLE] >= level, x + way, way / h


@kernel
def is_beyond(q, x, to_x):
    """Whether a step from x meets or passes a rigid stop."""
    return (to_x >= q[HIGH] and to_x > x and q[HIGH_RATE] == math.inf) or (
        to_x <= q[LOW] and to_x < x and q[LOW_RATE] == math.inf
    )


@kernel
def breakaway_time(q, curves, p, table, state, force, slope, h):
    """Time within h at which a resting stem's net force comes to exceed what holds it; it does so at h."""
    low, high = 0.0, h
    now, _s = excess(q, curves, p, table, state, 0.0, force)
    if now > 0.0:
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if high - low <= 1.0e-12 or middle <= low or middle >= high:
            break
        now, _s = excess(q, curves, p, table, state, middle, force + slope * middle)
        if now > 0.0:
            high = middle
        else:
            low = middle
    return high


@kernel
def slip(q, curves, p, table, state, force, slope, h, decay):
    """Return (time taken, position, velocity, mode) of a slip for at most h.

    It ends, as BAND, where its speed falls to the limit velocity.
    """
    x, v, taken = state[AT_X], state[AT_V], h
    s = 1.0 if v > 0.0 else -1.0
    to_x, to_v = slip_step(q, curves, p, table, state, s, force, slope, h, decay)
    if s * to_v >= q[D_V]:
        return taken, to_x, to_v, SLIP
    c = q[F_V] * (1.0 + s * q[VISCOUS_ASYMMETRY]) / q[M]
    low, high, over, under = 0.0, h, s * v - q[D_V], s * to_v - q[D_V]
    if over <= 0.0:
        # the slip begins at the limit velocity and does not gain: what it does is decided at once
        return 0.0, x, s * q[D_V], BAND
    for _ in range(_CUTS):
        if high - low < 1.0e-12:
            break
        taken = low + (high - low) * over / (over - under)
        to_x, to_v = slip_step(q, curves, p, table, state, s, force, slope, taken, math.exp(-c * taken))
        now = s * to_v - q[D_V]
        if abs(now) < 1.0e-9 * q[D_V]:
            break
        if now > 0.0:
            low, over = taken, now
        else:
            high, under = taken, now
    return taken, to_x, s * q[D_V], BAND


@kernel
def band_step(q, curves, p, table, state, force, slope, h):
    """Return the same as ``slip`` for a stem below its limit velocity, driven by what exceeds the breakaway's force.

    It ends, as SLIP, where its speed reaches the limit velocity, and with no speed where nothing exceeds it.
    """
    x, v = state[AT_X], state[AT_V]
    net, more, up, down = forces(q, curves, p, table, state, x + 0.5 * h * v, 0.5 * h, force + 0.5 * h * slope)
    s = 1.0 if net > 0.0 else -1.0
    added = up if s > 0.0 else down
    a = s * max(abs(net) - breakaway_level(q, p, state, s, more, added, 0.5 * h), 0.0) / q[M]
    if a == 0.0:
        return h, x + 0.5 * h * v, 0.0, BAND
    to_v = v + h * a
    if s * to_v >= q[D_V]:
        taken = min(max((s * q[D_V] - v) / a, 0.0), h)
        return taken, x + 0.5 * taken * (v + s * q[D_V]), s * q[D_V], SLIP
    return h, x + 0.5 * h * (v + to_v), to_v, BAND
