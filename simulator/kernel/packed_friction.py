"""What a packing does to friction: along the travel, in time, and from breakaway to breakaway."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math

from simulator.kernel.compiled import kernel
from simulator.kernel.packed_state import (
    AGE,
    DRAW,
    DRAWS,
    KNOT,
    KNOT_S,
    P_RISE,
    P_RISE_TIME,
    P_SCATTER,
    P_SHARE,
    P_START,
    P_STEP,
    P_WANDER,
    P_WANDER_TIME,
    SIDE,
    SINCE_KNOT,
    STILL_SINCE,
    STUCK,
    WANDER_FROM,
    WANDER_TO,
)
from simulator.kernel.random_numbers import normal_of
from valve.kernel.loads import coulomb_level, extra_static, load
from valve.kernel.slots import (
    AT_X,
    ELAPSED,
    EXTRA,
    F_S,
    HIGH,
    HIGH_RATE,
    IN_MODE,
    LOW,
    LOW_RATE,
    NEVER_MOVED,
    REST_SINCE,
    STATIC_ASYMMETRY,
    STATIC_SHARE,
)


@kernel
def next_knot(p, state, seed):
    """Draw the next knot of the wander, exactly as an Ornstein-Uhlenbeck process has it."""
    state[KNOT] += 1.0
    state[SINCE_KNOT] = 0.0
    state[WANDER_FROM] = state[WANDER_TO]
    keep = math.exp(-KNOT_S / p[P_WANDER_TIME])
    drawn = normal_of(seed, 2, int(state[KNOT]))
    state[WANDER_TO] = keep * state[WANDER_FROM] + p[P_WANDER] * math.sqrt(1.0 - keep * keep) * drawn


@kernel
def draw_breakaway(state, seed, side):
    """Draw the next breakaway, for this side; 0: for the one to which the load turns first."""
    state[DRAWS] += 1.0
    state[DRAW], state[SIDE] = normal_of(seed, 1, int(state[DRAWS])), side


@kernel
def turn_load(state, seed, s):
    """Note to which side a resting stem is loaded: turned over, the contact sets anew and another force frees it."""
    if state[SIDE] == 0.0:
        state[SIDE] = s
    elif state[SIDE] == -s:
        draw_breakaway(state, seed, s)


@kernel
def roughness_at(p, table, s, x):
    """Friction that this place adds for a stem that moves with direction s, N."""
    row = 0 if s > 0.0 else 1
    n = table.shape[1]
    u = (x - p[P_START]) / p[P_STEP]
    if u <= 0.0:
        return table[row, 0]
    if u >= n - 1:
        return table[row, n - 1]
    i = int(u)
    return table[row, i] + (u - i) * (table[row, i + 1] - table[row, i])


@kernel
def forces(q, curves, p, table, state, x, after, force):
    """Net force on a stem at rest, what effects and what the packing (for both directions) add to F_c.

    ``after``: time after that of ``state``.
    """
    net, more, _area = load(q, curves, x, state[ELAPSED] + after, force)
    wander = 0.0
    if p[P_WANDER] > 0.0:
        share = (state[SINCE_KNOT] + after) / KNOT_S
        wander = state[WANDER_FROM] + share * (state[WANDER_TO] - state[WANDER_FROM])
    return net, more, roughness_at(p, table, 1.0, x) + wander, roughness_at(p, table, -1.0, x) + wander


@kernel
def rest_extra(q, p, state, after):
    """What the rest so far adds to the force of the next breakaway."""
    extra = extra_static(q, state[ELAPSED] + after - state[REST_SINCE], state[NEVER_MOVED] > 0.0)
    if p[P_RISE] > 0.0:
        rested = state[AGE] + after - state[STILL_SINCE]
        extra += p[P_RISE] * (rested / (rested + p[P_RISE_TIME]) if rested < math.inf else 1.0)
    return extra


@kernel
def breakaway_level(q, p, state, s, more, added, after):
    """Force that this rest's breakaway needs towards s, never below what motion needs there."""
    extra = state[EXTRA]
    if state[IN_MODE] == STUCK:
        extra = rest_extra(q, p, state, after)
    level = (q[F_S] + q[STATIC_SHARE] * more + p[P_SHARE] * added + extra) * (1.0 + s * q[STATIC_ASYMMETRY])
    return max(level * (1.0 + p[P_SCATTER] * state[DRAW]), coulomb_level(q, s, more + added))


@kernel
def excess(q, curves, p, table, state, after, force):
    """Return by how much the net force on a resting stem exceeds what holds it, and its direction; 0 without force."""
    x = state[AT_X]
    net, more, up, down = forces(q, curves, p, table, state, x, after, force)
    s = 1.0 if net > 0.0 else -1.0 if net < 0.0 else 0.0
    if (s > 0.0 and x >= q[HIGH] and q[HIGH_RATE] == math.inf) or (s < 0.0 and x <= q[LOW] and q[LOW_RATE] == math.inf):
        return -math.inf, s
    return abs(net) - breakaway_level(q, p, state, s, more, up if s > 0.0 else down, after), s
