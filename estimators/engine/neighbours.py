"""What a section's rows hold of the motions before and after it: short rests are seen through the sensor's filter."""

# mypy: allow-untyped-defs
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

_MEETS_S: Final = 0.02  # a section ends where the next one begins
_MARGIN: Final = 0.2  # of a rest: the rows at either end that its level is not made of
_PLACES: Final = 20


@njit(cache=True, error_model="numpy")
def _fading(at_s, time_s, to_rest_m, filter_s):
    """What the sensor still shows of a motion at later times: as it was seen, behind its last node as it fades."""
    return np.interp(at_s, time_s, to_rest_m) * np.exp(-np.maximum(at_s - time_s[-1], 0.0) / filter_s)


@njit(cache=True, error_model="numpy")
def beside(nodes, away_m, sensed_m, stop, filter_s, others):
    """What the sensor shows of other motions, m: at the rows, and in the mean of the rest before each section.

    Its filter is linear, so that they add. Beside a short rest it is no trifle: a filter of 5 ms shows a tenth of an
    arrival 12 ms later, and the instant at which a stem of little friction has begun to move is seen milliseconds
    later. ``away_m`` and ``sensed_m``, shape (N,), are the motion and what the sensor shows of it, from each section's
    rest; ``stop``, shape (n,), is where it stopped. ``others`` says whether the motions beside are regarded at all.
    """
    count = stop.size
    rows_m, rest_m = np.zeros(nodes.row.size), np.zeros(count)
    for number in range(count):
        low, high = nodes.first[number], nodes.first[number + 1]
        rows = slice(nodes.first_row[number], nodes.first_row[number + 1])
        times_s = nodes.row_time_s[rows]
        seen_s = nodes.seen_s[number]
        arrived_s = seen_s - nodes.rest_way[1, number]
        inner_s = arrived_s + (nodes.rest_ends_s[number] - arrived_s) * np.linspace(_MARGIN, 1.0 - _MARGIN, _PLACES)
        rest_m[number] = np.interp(inner_s, nodes.time_s[low:high], sensed_m[low:high]).mean()
        if others and number > 0 and stop[number - 1] < low:
            before = slice(nodes.first[number - 1], low)
            if arrived_s <= nodes.time_s[low - 1] <= seen_s + _MEETS_S:
                sign = nodes.rest_way[0, number - 1]
                to_rest_m = sensed_m[before] - sign * max(sign * away_m[low - 1], 0.0)
                rows_m[rows] += _fading(times_s, nodes.time_s[before], to_rest_m, filter_s)
                rest_m[number] += _fading(inner_s, nodes.time_s[before], to_rest_m, filter_s).mean()
        if others and number + 1 < count and times_s[-1] > nodes.time_s[high]:
            after = slice(high, nodes.first[number + 2])
            rows_m[rows] += np.interp(times_s, nodes.time_s[after], sensed_m[after])
    return rows_m, rest_m
