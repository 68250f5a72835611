"""The motion of the Karnopp stem with its slots: one pass over the corners of the force.

Between two anchors (a corner, an output, a sub-step of a slip) the linear part of the motion is solved in closed
form, as in valve.kernel.follow. All slots neutral, nothing is added and the motion is the exact one.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math

import numpy as np

from valve.kernel.bristles import bristle_rest
from valve.kernel.compiled import kernel
from valve.kernel.force_line import force_line
from valve.kernel.loaded_rest import rest_length
from valve.kernel.loaded_slip import GLANCE_S, loaded_slip
from valve.kernel.loaded_steps import (
    FIRST_FOLLOWED_S,
    MORE_ON_BRISTLES,
    STRAIGHT_M,
    STRAIGHT_ON_BRISTLES_M,
    acting_rate,
    even_part,
    followed_step,
    linear_slip,
    loaded_band,
    longest_steps,
    slide_step,
    slip_part,
)
from valve.kernel.loads import (
    coulomb_level,
    drag_at,
    extra_static,
    finest_feature,
    is_neutral_in_motion,
    load,
    static_level,
    zone,
)
from valve.kernel.modes import (
    FOLLOWED,
    ROOT_NOT_FOUND,
    SLIDE,
    SLIP,
    STOPPED,
    STUCK,
    TOO_MANY_EVENTS,
    TOO_MANY_STEPS,
    regime,
)
from valve.kernel.sensing import displayed, sampled, sampled_rest, sense
from valve.kernel.slots import (
    AT_V,
    AT_X,
    BOW,
    BRISTLE,
    D_V,
    ELAPSED,
    EXTRA,
    F_0,
    F_V,
    GAIN,
    HIGH,
    HIGH_RATE,
    IN_MODE,
    LAGGED,
    LOW,
    LOW_RATE,
    NEVER_MOVED,
    PLAY,
    PLAYED,
    POSITION_LAG,
    PRESLIDING,
    PRESSURE_SHARE,
    REST_SINCE,
    SHOWN,
    STRIBECK,
    VIBRATION,
    VIBRATION_RATE,
    VISCOUS_ASYMMETRY,
    K,
)

# Twenty times what valves with any effect take (5 kHz at most): beyond, a stem without a spring runs off over a spot.
STEPS_A_SECOND = 1.0e5
FEWEST_STEPS = 1.0e6


@kernel
def follow_extended(
    q, curves, state, corner_time, corner_force, end_time, out_time, rest_time, rest_x, rest_since,
    out_x, out_sensed, out_v, out_mode, out_force, event_time, event_mode, most_events, longest,
):  # fmt: skip
    """Follow the stem from the first corner to ``end_time``, ``state`` in place; return (status, events, passes).

    Corners and outputs as in valve.kernel.follow; all five outputs are written. At each of ``rest_time``
    (rising) the stem is put to rest at ``rest_x``, where it rests since ``rest_since``. ``longest`` bounds the
    sub-steps of a slip whose slots are not neutral, and of a stem whose bristles give. ``passes`` is the number of
    steps that it took, one on bristles counted as four: the measure of its work.
    """
    DV = q[D_V]
    x, v, mode, extra = state[AT_X], state[AT_V], int(state[IN_MODE]), state[EXTRA]
    never_moved, rest_from, bristle = state[NEVER_MOVED] != 0.0, state[REST_SINCE], state[BRISTLE]
    clock = state[ELAPSED] - corner_time[0]  # from the corners' times to the slots' own
    low = q[LOW] if q[LOW_RATE] == math.inf else -math.inf
    high = q[HIGH] if q[HIGH_RATE] == math.inf else math.inf
    linear, finest, elastic = is_neutral_in_motion(q), finest_feature(q), q[PRESLIDING] > 0.0
    sensing = q[POSITION_LAG] > 0.0 or q[PLAY] > 0.0 or q[GAIN] != 1.0 or q[BOW] != 0.0
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
    most_passes = FEWEST_STEPS + STEPS_A_SECOND * (end_time - corner_time[0])
    lagging, follow = q[POSITION_LAG] > 0.0, FIRST_FOLLOWED_S
    if mode == STUCK and v == 0.0 and (x >= high or x <= low):
        mode = STOPPED
    for i in range(n):
        start = corner_time[i]
        if start > end_time:
            break
        fresh = fresh or (i > 0 and corner_time[i - 1] == start)
        counts, stop, slope = force_line(corner_time, corner_force, i, end_time)
        if not counts:
            continue
        # tau is kept beside the time: their difference would be rounded, and times a steep slope that is a force
        now_s, tau, going, follow = start, 0.0, True, min(FIRST_FOLLOWED_S, longest)
        while going:
            passes += 1
            if passes > most_passes:
                state[AT_X], state[AT_V], state[IN_MODE] = x, v, mode
                return TOO_MANY_STEPS, n_events, passes
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
            if fresh:
                follow = min(FIRST_FOLLOWED_S, longest)
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
                        push = acting_rate(
                            q, curves, linear, x, v, t, force, slope, area, net, side, heading, rate, coulomb,
                            static, extra, resting, rest_from, never_moved,
                        )  # fmt: skip
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
                most = min(follow, 0.1 / q[VIBRATION_RATE]) if q[VIBRATION] != 0.0 else follow
                left, before = even_part(left, most), elastic_v
                dwell, ended, x_next, v_next, bristle = bristle_rest(
                    q, curves, x, bristle, t, force, slope, t - rest_from, never_moved, left
                )
                passes += MORE_ON_BRISTLES
                elastic_v = (x_next - x) / dwell if dwell > 0.0 else 0.0
                follow = followed_step(follow, dwell, elastic_v - before, STRAIGHT_ON_BRISTLES_M, longest)
            else:
                if rate != rate_before:
                    rate_before = rate
                    most_there, swing = longest_steps(q, linear, rate, longest)
                most = min(most_there, follow) if lagging else most_there
                left = slip_part(q, s, v, mode == SLIP, net, coulomb, highest, viscous, most, swing, finest, left)
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
                    dwell, ended, x_next, v_next, v = linear_slip(
                        q, s, x, v, net, slope, drag, viscous, rate, low, high, left, rising if s > 0.0 else falling
                    )
                    if math.isnan(dwell):
                        state[AT_X], state[AT_V], state[IN_MODE] = x, v, mode
                        return ROOT_NOT_FOUND, n_events, passes
                elif mode == SLIDE:
                    dwell, ended, x_next, v_next = slide_step(
                        q, curves, linear, s, x, t, force, slope, net, rate, viscous, drag, static, low, high, left
                    )
                else:
                    dwell, ended, x_next, v_next, left = loaded_band(
                        q, curves, linear, s, x, v, t, force, slope, net, rate, static, beyond, low, high,
                        rounding, left,
                    )  # fmt: skip
                if lagging:
                    follow = followed_step(follow, dwell, v_next - v, STRAIGHT_M, longest)
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
                out = sampled_rest(
                    out, after_s, out_time, q, state, sensing, x, mode, now_s, start, corner_force[i], slope,
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
