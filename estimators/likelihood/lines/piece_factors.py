"""Rows of a noisy channel as triangular factors, compiled: joined to longer pieces, and what a polynomial leaves.

A piece is kept as the triangular factor R, shape (5, 5), of its rows [1, u, u^2, u^3, y] with u = (t - centre)/half:
two pieces join by a few rotations, and the squares that a polynomial of degree d leaves are those of the last column
below row d. With ``lag_s`` above 0 the rows are [1, u, exp(-(t - start)/lag), 0, y]: what a first-order lag makes of
a line, "degree" 2. Times are in s; values and their noise in any one unit. Plain functions, typed, compiled below.
"""

# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from estimators.compiled import kernel_of
from estimators.samples import FloatArray

COLUMNS = 5
CHUNK = 64


def _rotate_in(factor: FloatArray, row: FloatArray, first: int) -> None:
    """Add one row, zero before column ``first``, to the factor by Givens rotations; the row is used up."""
    for column in range(first, COLUMNS):
        below = row[column]
        if below != 0.0:
            above = factor[column, column]
            length = np.sqrt(above * above + below * below)
            cosine, sine = above / length, below / length
            factor[column, column] = length
            for other in range(column + 1, COLUMNS):
                kept = factor[column, other]
                factor[column, other] = cosine * kept + sine * row[other]
                row[other] = cosine * row[other] - sine * kept


def _add_rows(
    factor: FloatArray,
    time_s: FloatArray,
    value: FloatArray,
    first: int,
    last: int,
    centre_s: float,
    half_s: float,
    lag_s: float,
) -> None:
    """Add rows ``first`` up to and without ``last``."""
    row = np.empty(COLUMNS)
    start_s = centre_s - half_s
    for i in range(first, last):
        u = (time_s[i] - centre_s) / half_s
        row[0] = 1.0
        row[1] = u
        row[2] = u * u if lag_s == 0.0 else math.exp((start_s - time_s[i]) / lag_s)
        row[3] = u * u * u if lag_s == 0.0 else 0.0
        row[4] = value[i]
        rotate_in(factor, row, 0)


def _add_factor(factor: FloatArray, other: FloatArray, scale: float, shift: float, decay: float) -> None:
    """Add a factor in u to one in w = scale u + shift; with ``decay`` not negative, with that share of its exp."""
    row = np.empty(COLUMNS)
    for i in range(COLUMNS):
        one, two, three = other[i, 1], other[i, 2], other[i, 3]
        row[0] = other[i, 0]
        row[1] = scale * one + shift * other[i, 0]
        row[2] = scale * (scale * two + 2.0 * shift * one) + shift * shift * other[i, 0]
        row[3] = scale * scale * (scale * three + 3.0 * shift * two) + shift * shift * (
            3.0 * scale * one + shift * other[i, 0]
        )
        if decay >= 0.0:
            row[2], row[3] = decay * two, 0.0
        row[4] = other[i, 4]
        rotate_in(factor, row, i)


def _half_length(time_s: FloatArray, first: int, last: int) -> float:
    half_s = 0.5 * (time_s[last - 1] - time_s[first])
    return half_s if half_s > 0.0 else 1.0


def _decay(from_s: float, to_s: float, lag_s: float) -> float:
    return -1.0 if lag_s == 0.0 else math.exp((from_s - to_s) / lag_s)


def _joined_factor(
    time_s: FloatArray, one: FloatArray, two: FloatArray, first: int, middle: int, last: int, lag_s: float
) -> FloatArray:
    """Factor of rows first to last from those of first to middle and of middle to last."""
    centre_s, half_s = 0.5 * (time_s[first] + time_s[last - 1]), half_length(time_s, first, last)
    joined = np.zeros((COLUMNS, COLUMNS))
    for part in range(2):
        begin, end = (first, middle) if part == 0 else (middle, last)
        own_centre_s, own_half_s = 0.5 * (time_s[begin] + time_s[end - 1]), half_length(time_s, begin, end)
        left = decay_over(centre_s - half_s, own_centre_s - own_half_s, lag_s)
        add_factor(joined, one if part == 0 else two, own_half_s / half_s, (own_centre_s - centre_s) / half_s, left)
    return joined


def _best_degree(factor: FloatArray, rows: int, weight: float, price: float) -> tuple[float, int]:
    """Return the least of squares left, times ``weight``, plus ``price`` a coefficient; and the degree for it.

    A curve costs 2 more: three lines, not a cubic and a line, where the two do as well.
    """
    best, degree = np.inf, 1
    for tried in range(1, 4):
        if tried > 1 and rows < tried + 2:
            break
        left = 0.0
        for i in range(tried + 1, COLUMNS):
            left += factor[i, 4] * factor[i, 4]
        cost = weight * left + price * (tried + 1 + (2 if tried > 1 else 0))
        if cost < best:
            best, degree = cost, tried
    return best, degree


def _chunks(time_s: FloatArray, value: FloatArray, lag_s: float) -> FloatArray:
    """Factors of each CHUNK rows, shape (chunks, 5, 5), so that a long range is summed quickly."""
    count = time_s.size // CHUNK
    factors = np.zeros((count, COLUMNS, COLUMNS))
    for i in range(count):
        first, last = i * CHUNK, (i + 1) * CHUNK
        centre_s = 0.5 * (time_s[first] + time_s[last - 1])
        add_rows(factors[i], time_s, value, first, last, centre_s, half_length(time_s, first, last), lag_s)
    return factors


def _add_range(
    factor: FloatArray,
    time_s: FloatArray,
    value: FloatArray,
    chunks: FloatArray,
    first: int,
    last: int,
    centre_s: float,
    half_s: float,
    lag_s: float,
) -> None:
    """Add rows ``first`` up to and without ``last``, whole chunks at once."""
    begin, end = -(-first // CHUNK), last // CHUNK
    if end <= begin:
        add_rows(factor, time_s, value, first, last, centre_s, half_s, lag_s)
        return
    add_rows(factor, time_s, value, first, begin * CHUNK, centre_s, half_s, lag_s)
    for i in range(begin, end):
        from_row, to_row = i * CHUNK, (i + 1) * CHUNK
        own_centre_s, own_half_s = 0.5 * (time_s[from_row] + time_s[to_row - 1]), half_length(time_s, from_row, to_row)
        left = decay_over(centre_s - half_s, own_centre_s - own_half_s, lag_s)
        add_factor(factor, chunks[i], own_half_s / half_s, (own_centre_s - centre_s) / half_s, left)
    add_rows(factor, time_s, value, end * CHUNK, last, centre_s, half_s, lag_s)


def _piece_factor(
    time_s: FloatArray, value: FloatArray, chunks: FloatArray, first: int, last: int, lag_s: float
) -> FloatArray:
    """Factor of rows first to last about their own centre."""
    factor = np.zeros((COLUMNS, COLUMNS))
    centre_s = 0.5 * (time_s[first] + time_s[last - 1])
    add_range(factor, time_s, value, chunks, first, last, centre_s, half_length(time_s, first, last), lag_s)
    return factor


_compiled = kernel_of(__file__)
rotate_in = _compiled(_rotate_in)
add_rows = _compiled(_add_rows)
add_factor = _compiled(_add_factor)
decay_over = _compiled(_decay)
half_length = _compiled(_half_length)
joined_factor = _compiled(_joined_factor)
best_degree = _compiled(_best_degree)
chunks_of: Callable[[FloatArray, FloatArray, float], FloatArray] = _compiled(_chunks)
add_range = _compiled(_add_range)
piece_factor: Callable[[FloatArray, FloatArray, FloatArray, int, int, float], FloatArray] = _compiled(_piece_factor)
