"""The compiled simulation of the likelihood: the stem followed from one start, or anew from each of several."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments, as in valve.kernel
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve.kernel.compiled import kernel
from valve.kernel.follow import follow
from valve.kernel.modes import FOLLOWED, SLIP, STUCK

FROM_THE_FIRST_ROW: Final = np.zeros(1, np.int64)


@kernel
def shoot(
    q, corner_time, corner_force, out_time, even_step, first_row, start_time, start_x, start_v, out_x, most_events,
):  # fmt: skip
    """Write the position at ``out_time`` to ``out_x``; return the kernel's status of the first part that failed.

    ``q`` is m, k, F_v, F_c, F_s, DV, F_0 and both stops. Part j covers the rows from first_row[j] to the next part's
    and begins at start_time[j] (not after its first row) with start_x[j] and start_v[j]. Before its first corner the
    force is held.
    """
    none, no_mode = np.empty(0), np.empty(0, np.int8)
    n, parts, corners = out_time.size, first_row.size, corner_time.size
    for j in range(parts):
        begin = first_row[j]
        end = first_row[j + 1] if j + 1 < parts else n
        if end <= begin:
            continue
        start, last = start_time[j], out_time[end - 1]
        first = np.searchsorted(corner_time, start, side="right")
        after = np.searchsorted(corner_time, last, side="right")
        after = min(after + 1, corners)
        times, forces = np.empty(after - first + 1), np.empty(after - first + 1)
        times[0] = start
        if first == 0:
            forces[0] = corner_force[0]
        elif first == corners:
            forces[0] = corner_force[corners - 1]
        else:
            share = (start - corner_time[first - 1]) / (corner_time[first] - corner_time[first - 1])
            forces[0] = corner_force[first - 1] + share * (corner_force[first] - corner_force[first - 1])
        times[1:] = corner_time[first:after]
        forces[1:] = corner_force[first:after]
        x = min(max(start_x[j], q[7]), q[8])
        v = start_v[j]
        status, _events, _x, _v, _mode = follow(
            q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7], q[8], x, v, (STUCK if v == 0.0 else SLIP),
            times, forces, last, out_time[begin:end], even_step, out_x[begin:end], none, no_mode, none,
            none, no_mode, most_events,
        )  # fmt: skip
        if status != FOLLOWED:
            return status
    return FOLLOWED


@kernel
def shoot_each(
    points, logarithmic, unit, valve_place, start_place, speed_place, rest_x, corner_time, corner_force, out_time,
    even_step, first_out, start_time, first_side, second_side, most_events, position, followed,
):  # fmt: skip
    """Shoot for the unknowns in each row of ``points``; write positions, and whether the stem could be followed.

    ``valve_place`` are the places of m, k, F_v, F_c, F_s/F_c - 1, DV, F_0 and both stops among the unknowns, and
    ``start_place`` and ``speed_place`` those of each part's start; below 0 there is none, and a part starts at
    ``rest_x`` and at rest. A row's position is the mean of the outputs ``first_side`` and ``second_side``.
    """
    out_x = np.empty(out_time.size)
    for i in range(points.shape[0]):
        followed[i] = shoot_at(
            points[i], logarithmic, unit, valve_place, start_place, speed_place, rest_x, corner_time, corner_force,
            out_time, even_step, first_out, start_time, first_side, second_side, most_events, out_x, position[i],
        )  # fmt: skip


@kernel
def shoot_at(
    point, logarithmic, unit, valve_place, start_place, speed_place, rest_x, corner_time, corner_force, out_time,
    even_step, first_out, start_time, first_side, second_side, most_events, out_x, position,
):  # fmt: skip
    """Shoot for one point as ``shoot_each`` does, with ``out_x`` to work in; return whether it could be followed."""
    parts, q = start_place.size, np.empty(9)
    start_x, start_v = np.empty(parts), np.empty(parts)
    value = np.empty(point.size)
    for j in range(value.size):
        value[j] = math.exp(point[j]) if logarithmic[j] else point[j] * unit[j]
    for j in range(9):
        place = valve_place[j]
        q[j] = value[place] if place >= 0 else (-math.inf if j == 7 else math.inf)
    q[4] = q[3] * (1.0 + q[4])
    for j in range(parts):
        start_x[j] = value[start_place[j]] if start_place[j] >= 0 else rest_x[j]
        start_v[j] = value[speed_place[j]] if speed_place[j] >= 0 else 0.0
    has_sides = first_side.size > 0
    status = shoot(
        q, corner_time, corner_force, out_time, even_step, first_out, start_time, start_x, start_v,
        out_x if has_sides else position, most_events,
    )  # fmt: skip
    if has_sides:
        for n in range(position.size):
            position[n] = 0.5 * (out_x[first_side[n]] + out_x[second_side[n]])
    return status == FOLLOWED and math.isfinite(position[position.size - 1])


@kernel
def differences(
    point, numbers, sizes, lower, upper, is_one_sided, here, weight, largest, logarithmic, unit, valve_place,
    start_place, speed_place, rest_x, above_time, above_force, below_time, below_force, out_time, even_step, first_out,
    start_time, first_side, second_side, most_events, slopes,
):  # fmt: skip
    """Write the derivatives of the weighted positions to some of the unknowns, by ``numbers``, to rows of ``slopes``.

    By central differences of ``sizes``; one-sided where that is asked for, at a bound, and where the sides'
    difference is above ``largest``: then the lesser of both, or none. The corners of the force may differ on both
    sides. ``here`` is the position at ``point``. Return whether each of the unknowns has a side.
    """
    has_all = True
    out_x, above, below = np.empty(out_time.size), np.empty(here.size), np.empty(here.size)
    moved = point.copy()
    for i in numbers:
        own, h = slopes[i], sizes[i]
        has_above = has_below = False
        if point[i] + h <= upper[i]:
            moved[i] = point[i] + h
            has_above = shoot_at(
                moved, logarithmic, unit, valve_place, start_place, speed_place, rest_x, above_time, above_force,
                out_time, even_step, first_out, start_time, first_side, second_side, most_events, out_x, above,
            )  # fmt: skip
        if point[i] - h >= lower[i] and not (is_one_sided and has_above):
            moved[i] = point[i] - h
            has_below = shoot_at(
                moved, logarithmic, unit, valve_place, start_place, speed_place, rest_x, below_time, below_force,
                out_time, even_step, first_out, start_time, first_side, second_side, most_events, out_x, below,
            )  # fmt: skip
        moved[i] = point[i]
        has_all &= has_above or has_below
        steepest = of_above = of_below = 0.0
        for n in range(own.size):
            rise = (above[n] - here[n]) / h if has_above else 0.0
            fall = (here[n] - below[n]) / h if has_below else 0.0
            of_above, of_below = max(of_above, abs(rise)), max(of_below, abs(fall))
            own[n] = 0.5 * (rise + fall) if has_above and has_below else rise + fall
            steepest = max(steepest, abs(own[n]))
        if steepest > largest and has_above and has_below:
            # one of the sides slips once more or less
            for n in range(own.size):
                own[n] = ((above[n] - here[n]) if of_above <= of_below else (here[n] - below[n])) / h
            steepest = min(of_above, of_below)
        for n in range(own.size):
            own[n] = 0.0 if steepest > largest else own[n] * weight[n]
    return has_all
