"""The normal equations of the rows of all sections: how each answers to every unknown, free of the noise."""

# mypy: allow-untyped-defs
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import numpy as np
from numba import njit

from estimators.engine.fields import between
from estimators.engine.motion import answers
from estimators.engine.parameters import FC, FO, GLOBALS, LEAD, LN_DV, LN_FILTER, LN_K, LN_M, LN_V
from estimators.engine.whitening import gather, whitened

VARIED = (LN_M, LN_V, LN_K, LN_FILTER, LN_DV)  # then the instants of breakaway, then the laws' parameters
_FORCED = 3  # lines of F_0, F_c and the lead; that of the rest's level follows


@njit(cache=True, error_model="numpy")
def _hats(out, first, left, share, sign):
    """Into ``out``, shape (knots, nodes), the knots' shares at each node, times ``sign``."""
    out[:] = 0.0
    for node in range(out.shape[1]):
        out[left[node] - first, node] = sign * (1.0 - share[node])
        out[left[node] - first + 1, node] = sign * share[node]


@njit(cache=True, error_model="numpy")
def row_equations(
    nodes, steps, instants, stops, knots, travel_m, spring, stiffer, off_m, direct, moved, noise, normal, right
):
    """Add the equations of all rows to ``normal`` and ``right``; the sum of squares, and of the variances' logarithms.

    ``steps`` are those of ``motion.Steps``, ``instants`` those of ``motion.instants``; ``stops`` says of each section
    where the stem stopped, at which share of the step, and how far it goes on there (``motion.answers``). ``knots``
    are the fields', over travel and in time. ``off_m``, shape (R,), is measured less modelled, ``direct``, shape
    (p, R), how the rows answer to what is varied, and ``moved``, shape (p, N), how far the stem is elsewhere then: it
    meets another friction there. ``noise``: the variances of the rows and of the coloured noise, and its time.
    """
    state, from_start, from_end, sensor = steps
    begins, after, share_at = instants
    stop, stop_share, later = stops
    knots_m, knots_s = knots
    white, coloured, coloured_s = noise
    count, varied = begins.size, moved.shape[0]
    fields = 2 * knots_m.size + knots_s.size
    own_steps = sensor.size - count
    squares = logarithms = 0.0
    for number in range(count):
        low, high = nodes.first[number], nodes.first[number + 1]
        rows = slice(nodes.first_row[number], nodes.first_row[number + 1])
        sign, size = nodes.rest_way[0, number], high - low
        first = first_s = 0
        last = last_s = -1  # without knots
        left = left_s = np.empty(0, np.int64)
        share = share_s = np.empty(0)
        if knots_m.size > 0:
            left, share = between(knots_m, travel_m[low:high])
            left_s, share_s = between(knots_s, nodes.time_s[low:high])
            first, last, first_s, last_s = left.min(), left.max() + 1, left_s.min(), left_s.max() + 1
        in_time = _FORCED + 1 + last - first + 1
        met = in_time + last_s - first_s + 1
        driven = np.empty((met + varied, size))
        numbers = np.empty(met + varied, np.int64)
        driven[0], driven[1], driven[2], driven[3] = -1.0, -sign, -nodes.rate_n_per_s[low:high], -spring
        numbers[0], numbers[1], numbers[2] = FO, FC, LEAD
        numbers[3] = GLOBALS + fields + count + number
        if knots_m.size > 0:
            _hats(driven[_FORCED + 1 : in_time], first, left, share, -sign)
            _hats(driven[in_time:met], first_s, left_s, share_s, -sign)
        for line in range(_FORCED + 1, in_time):
            numbers[line] = GLOBALS + first + line - _FORCED - 1 + (0 if sign > 0.0 else knots_m.size)
        for line in range(in_time, met):
            numbers[line] = GLOBALS + 2 * knots_m.size + first_s + line - in_time
        for line in range(varied):
            driven[met + line] = -stiffer[low:high] * moved[line, low:high]
            if line < len(VARIED):
                numbers[met + line] = VARIED[line]
            elif line == len(VARIED):
                numbers[met + line] = GLOBALS + fields + number
            else:
                numbers[met + line] = GLOBALS + fields + 2 * count + line - len(VARIED) - 1
        at = after[number] - low
        at_instant = driven[:, at - 1] + share_at[number] * (driven[:, at] - driven[:, at - 1])
        lines_m = np.zeros((1 + met + varied, rows.stop - rows.start))
        lines_m[0] = off_m[rows]
        answers(
            nodes.step[low:high], nodes.row[rows] - low, own_steps + number, begins[number] - low, stop[number] - low,
            stop_share[number], later[number], at_instant, driven, stiffer[low:high], state, from_start, from_end,
            sensor, lines_m[1:],
        )  # fmt: skip
        lines_m[1 + _FORCED] += 1.0
        lines_m[1 + met :] += direct[:, rows]
        free, of_variances = whitened(nodes.row_time_s[rows], lines_m, white[rows], coloured, coloured_s)
        gather(free, numbers, normal, right)
        squares += np.dot(free[0], free[0])
        logarithms += of_variances
    return squares, logarithms
