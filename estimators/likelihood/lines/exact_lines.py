"""The corners of a channel that is computed or commanded: straight between corners, known to rounding."""

from __future__ import annotations

import numpy as np

from estimators.likelihood.lines.piece_kernel import lines
from estimators.samples import BoolArray, FloatArray, IntArray

_ENOUGH_ROWS = 3  # fewer lie on a line by chance


def exact_corners(time_s: FloatArray, value: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray, int]:
    """Return corner times and values, and how many of these are no crossing of two lines.

    Lines through at least 3 rows are drawn on to where they cross, between the last row of one and the first of
    the next. Where they do not cross there the channel has stepped: two corners in the middle between the rows. A
    row on no line is a corner itself.
    """
    edges = lines(time_s, value, tolerance)
    first, last = edges[:-1], edges[1:] - 1
    long = last - first + 1 >= _ENOUGH_ROWS
    centre_s, level, slope = _fitted_lines(time_s, value, edges)
    at_s, own, corner = _between(time_s, first, last, long, centre_s=centre_s, level=level, slope=slope)
    # each row that stands for itself, each crossing or step, and both ends, in order of time
    alone = np.zeros(time_s.size, dtype=np.bool_)
    alone[[0, -1]] = True
    plain = ~corner
    alone[last[:-1][plain]] = True
    alone[first[1:][plain]] = True
    short = np.flatnonzero(~long)
    alone[first[short]] = True
    alone[last[short]] = True
    rows = np.flatnonzero(alone)
    piece = np.searchsorted(edges, rows, side="right") - 1
    row_value = np.where(long[piece], level[piece] + slope[piece] * (time_s[rows] - centre_s[piece]), value[rows])
    times = np.concatenate([time_s[rows], at_s])
    values = np.concatenate([row_value, own])
    order = np.argsort(times, kind="stable")
    return times[order], values[order], int(rows.size + at_s.size - np.unique(at_s).size)


def _fitted_lines(time_s: FloatArray, value: FloatArray, edges: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centre, level there and slope of the least-squares line through each run of rows, shape (k,)."""
    rows = np.diff(edges)
    starts = edges[:-1]
    centre_s = np.add.reduceat(time_s, starts) / rows
    level = np.add.reduceat(value, starts) / rows
    piece = np.repeat(np.arange(rows.size), rows)
    apart_s, above = time_s - centre_s[piece], value - level[piece]
    square = np.add.reduceat(apart_s * apart_s, starts)
    product = np.add.reduceat(apart_s * above, starts)
    slope = np.divide(product, square, out=np.zeros_like(product), where=square > 0.0)
    return centre_s, level, slope


def _between(
    time_s: FloatArray,
    first: IntArray,
    last: IntArray,
    long: BoolArray,
    *,
    centre_s: FloatArray,
    level: FloatArray,
    slope: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Times and values of crossings and steps, and at which joints, shape (k - 1,), there is one."""
    both = long[:-1] & long[1:]
    left, right = np.flatnonzero(both), np.flatnonzero(both) + 1
    before_s, after_s = time_s[last[left]], time_s[first[right]]
    middle_s = 0.5 * (before_s + after_s)
    one = level[left] + slope[left] * (middle_s - centre_s[left])
    two = level[right] + slope[right] * (middle_s - centre_s[right])
    bend = slope[right] - slope[left]
    after_middle_s = np.divide(one - two, bend, out=np.full_like(bend, np.inf), where=bend != 0.0)
    # 0.501 and not 0.5: a corner on a row is there to rounding only
    crosses = np.abs(after_middle_s) <= 0.501 * (after_s - before_s)
    crossing_s = np.where(crosses, middle_s + after_middle_s, middle_s)
    at_left = level[left] + slope[left] * (crossing_s - centre_s[left])
    at_right = level[right] + slope[right] * (crossing_s - centre_s[right])
    times = np.concatenate([crossing_s, crossing_s[~crosses]])
    values = np.concatenate([at_left, at_right[~crosses]])
    order = np.argsort(times, kind="stable")
    return times[order], values[order], both
