"""The stem of a valve with a packing, by small fixed steps: its friction differs with place, time and breakaway.

Nothing of the exact event-driven motion (valve.motion) is used here, so that each can judge the other. Of
valve.kernel come the laws alone: what force the slots of an extended valve add (loads), what its sensor shows
(sensing). A step of a slip takes force and friction at its middle and the viscous friction exactly, so its error is
of second order and a heavily damped stem stays stable; a step that passes the limit velocity, a breakaway or a stop
is cut there.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math

from simulator.kernel.compiled import kernel
from simulator.kernel.packed_friction import breakaway_level, excess, forces, next_knot, rest_extra, turn_load
from simulator.kernel.packed_state import (
    BAND,
    FILTERED,
    KNOT_S,
    P_FILTER,
    P_RISE,
    P_WANDER,
    SINCE_KNOT,
    SLIDE,
    SLIP,
    SLIPPED,
    STOPPED,
    STUCK,
)
from simulator.kernel.packed_steps import (
    band_step,
    breakaway_time,
    bristle_step,
    come_to_rest,
    count_way,
    follow_sensor,
    is_beyond,
    pass_time,
    sensor_is_settled,
    slip,
)
from valve.kernel.loads import coulomb_level, drag_at
from valve.kernel.sensing import displayed
from valve.kernel.slots import (
    AT_V,
    AT_X,
    BRISTLE,
    D_V,
    DRIFT,
    DWELL_RISE,
    EXTRA,
    F_V,
    HIGH,
    IN_MODE,
    LAGGED,
    LOW,
    NEVER_MOVED,
    PLAYED,
    PRESLIDING,
    SHOWN,
    VIBRATION,
    VISCOUS_ASYMMETRY,
    M,
)


@kernel
def follow_packed(
    q, curves, p, table, seed, state, corner_time, corner_force, end, out_time, step,
    out_x, out_sensed, out_v, out_mode, out_friction, event_time, event_x, event_level, rest_time,
):  # fmt: skip
    """Follow the stem from ``state`` to ``end``, in place; return the numbers of breakaways and of rests after them.

    Outputs at ``out_time``, rising. ``out_friction``: the Coulomb level that motion meets or would meet there towards
    the last direction, signed by it. Each breakaway is noted as far as there is room: its time, place and signed force;
    and when the stem came to rest after it. -1 breakaways: the last one before this run led to no slip.
    """
    t, leg, i, events, rests = corner_time[0], 0, 0, 0, 0
    n = corner_time.size
    # the net force is straight in time and so is what holds, but for these: else its excess is largest at an end
    bends = q[DRIFT] != 0.0 or q[DWELL_RISE] != 0.0 or p[P_RISE] > 0.0
    cached_h, decay_up, decay_down, keep = -1.0, 1.0, 1.0, 1.0
    heading = 1.0
    if math.isnan(state[PLAYED]):
        state[PLAYED] = state[AT_X]
        state[SHOWN] = displayed(q, state[AT_X])
        state[LAGGED] = state[SHOWN]
        state[FILTERED] = state[SHOWN]
    while True:
        while leg + 1 < n and corner_time[leg + 1] <= t:
            leg += 1
        if leg + 1 < n:
            slope = (corner_force[leg + 1] - corner_force[leg]) / (corner_time[leg + 1] - corner_time[leg])
            start = corner_force[leg] - slope * corner_time[leg]
            force = corner_force[leg] + slope * (t - corner_time[leg])
        else:
            slope, start, force = 0.0, corner_force[n - 1], corner_force[n - 1]
        while i < out_time.size and out_time[i] <= t:
            if state[AT_V] != 0.0:
                heading = 1.0 if state[AT_V] > 0.0 else -1.0
            _net, more, up, down = forces(q, curves, p, table, state, state[AT_X], 0.0, force)
            out_x[i], out_sensed[i], out_v[i] = state[AT_X], state[FILTERED], state[AT_V]
            mode = int(state[IN_MODE])
            if mode == STUCK and not q[LOW] < state[AT_X] < q[HIGH]:
                mode = STOPPED
            out_mode[i] = mode
            out_friction[i] = heading * coulomb_level(q, heading, more + (up if heading > 0.0 else down))
            i += 1
        if t >= end:
            return events, rests
        until = end
        if leg + 1 < n:
            until = min(until, corner_time[leg + 1])
        if i < out_time.size:
            until = min(until, out_time[i])
        if p[P_WANDER] > 0.0:
            if state[SINCE_KNOT] >= KNOT_S * (1.0 - 1.0e-9):
                next_knot(p, state, seed)
            until = min(until, t + KNOT_S - state[SINCE_KNOT])
        while t < until:
            left = until - t
            force = start + slope * t
            x, mode = state[AT_X], state[IN_MODE]
            if mode == STUCK and q[PRESLIDING] == 0.0:
                h = left
                if q[VIBRATION] != 0.0:
                    h = min(left, step)
                elif bends:
                    h = min(left, KNOT_S)
                _over, s = excess(q, curves, p, table, state, h, force + slope * h)
                turn_load(state, seed, s)
                over, s = excess(q, curves, p, table, state, h, force + slope * h)
                if over > 0.0:
                    h = breakaway_time(q, curves, p, table, state, force, slope, h)
                    if events < event_time.size:
                        net, more, up, down = forces(q, curves, p, table, state, x, h, force + slope * h)
                        added = up if s > 0.0 else down
                        event_time[events], event_x[events] = t + h, x
                        event_level[events] = s * breakaway_level(q, p, state, s, more, added, h)
                    events += 1
                    state[EXTRA] = rest_extra(q, p, state, h)
                pass_time(p, state, h)
                if h > 0.0 and not sensor_is_settled(q, p, state):
                    keep_rest = math.exp(-h / p[P_FILTER]) if p[P_FILTER] > 0.0 else 0.0
                    follow_sensor(q, p, state, x, h, keep_rest)
                t = until if h == left else t + h
                if over > 0.0:
                    state[IN_MODE] = BAND
                continue
            pieces = max(math.ceil(left / step * (1.0 - 1.0e-9)), 1)
            h = left / pieces
            if abs(h - cached_h) > 1.0e-9 * cached_h:
                cached_h = h
                c = q[F_V] / q[M]
                decay_up = math.exp(-c * (1.0 + q[VISCOUS_ASYMMETRY]) * h)
                decay_down = math.exp(-c * (1.0 - q[VISCOUS_ASYMMETRY]) * h)
                keep = math.exp(-h / p[P_FILTER]) if p[P_FILTER] > 0.0 else 0.0
            taken, to_x, to_v, to_mode = h, x, state[AT_V], mode
            if mode == STUCK:
                gives_way, to_x, speed = bristle_step(q, curves, p, table, seed, state, force, slope, h)
                to_v = 0.0
                if is_beyond(q, x, to_x):
                    # pressed onto a stop: it holds what the bristles do not
                    to_x, gives_way, state[BRISTLE] = q[HIGH] if to_x > x else q[LOW], False, math.nan
                if gives_way:
                    if events < event_time.size:
                        event_time[events], event_x[events], event_level[events] = t + h, to_x, state[BRISTLE]
                    events += 1
                    to_v = speed
                    to_mode = SLIP if abs(speed) >= q[D_V] else BAND
            elif mode == SLIP:
                decay = decay_up if state[AT_V] > 0.0 else decay_down
                taken, to_x, to_v, to_mode = slip(q, curves, p, table, state, force, slope, h, decay)
            elif mode == SLIDE:
                s = 1.0 if state[AT_V] > 0.0 else -1.0
                to_x = x + state[AT_V] * h
                to_mode = BAND
            else:
                taken, to_x, to_v, to_mode = band_step(q, curves, p, table, state, force, slope, h)
            # a rigid stop ends any step
            if mode != STUCK and is_beyond(q, x, to_x):
                edge = q[HIGH] if to_x > x else q[LOW]
                taken *= (edge - x) / (to_x - x)
                to_x, to_v, to_mode = edge, 0.0, BAND
            if to_x != x:
                count_way(state, to_x)
            pass_time(p, state, taken)
            kept = keep
            if taken != h:
                kept = math.exp(-taken / p[P_FILTER]) if p[P_FILTER] > 0.0 else 0.0
            follow_sensor(q, p, state, to_x, taken, kept)
            t = until if taken == left or (taken == h and pieces == 1) else t + taken
            state[AT_X], state[AT_V] = to_x, to_v
            if mode == STUCK:
                state[IN_MODE] = to_mode
                if to_mode != STUCK:
                    state[NEVER_MOVED], state[SLIPPED], state[BRISTLE] = 0.0, 1.0, math.nan
                continue
            if to_mode == SLIP:
                state[NEVER_MOVED], state[SLIPPED], state[EXTRA] = 0.0, 1.0, 0.0
                if mode == SLIP:
                    continue
            if to_mode == BAND and mode == BAND and to_v != 0.0:
                continue
            # at the limit velocity, or at rest: what comes next is decided by the force there
            net, more, up, down = forces(q, curves, p, table, state, to_x, 0.0, start + slope * t)
            s = 1.0 if net > 0.0 else -1.0
            added = up if s > 0.0 else down
            level = breakaway_level(q, p, state, s, more, added, 0.0)
            if to_v == 0.0:
                if state[SLIPPED] == 0.0:
                    events -= 1  # it gave way and did not get far enough to slip
                else:
                    if rests < rest_time.size:
                        rest_time[rests] = t
                    rests += 1
                come_to_rest(state, seed)
                continue
            way = 1.0 if to_v > 0.0 else -1.0
            if abs(net) <= level and not (mode == BAND and to_mode == SLIP):
                if rests < rest_time.size:
                    rest_time[rests] = t
                rests += 1
                come_to_rest(state, seed)
            elif s != way:
                state[IN_MODE] = BAND
            else:
                moving = drag_at(q, coulomb_level(q, s, more + added), level, q[D_V])
                moving += q[F_V] * (1.0 + s * q[VISCOUS_ASYMMETRY]) * q[D_V]
                state[IN_MODE] = SLIP if abs(net) > moving and taken > 0.0 else SLIDE
