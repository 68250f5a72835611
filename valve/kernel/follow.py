"""The exact motion of the Karnopp stem: one pass over the corners of the force, from event to event."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math

import numpy as np

from valve.kernel.compiled import kernel
from valve.kernel.force_line import force_line
from valve.kernel.mode_steps import band_step, rest_end, slide_end, slip_step
from valve.kernel.modes import BAND, FOLLOWED, ROOT_NOT_FOUND, SLIDE, SLIP, STOPPED, STUCK, TOO_MANY_EVENTS, regime
from valve.kernel.sampling import BLOCK, first_at_or_after, sample_marks, sample_motion, sample_straight


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
        start = corner_time[i]
        if start > end_time:
            break
        counts, stop, slope = force_line(corner_time, corner_force, i, end_time)
        if not counts:
            continue
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
