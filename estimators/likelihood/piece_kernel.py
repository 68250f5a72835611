"""The compiled search for the fewest pieces, lines up to cubics, that a noisy channel allows.

A piece is kept as the triangular factor R, shape (5, 5), of its rows [1, u, u^2, u^3, y] with u = (t - centre)/half:
two pieces join by a few rotations, and the squares that a polynomial of degree d leaves are those of the last column
below row d. With ``lag_s`` above 0 the rows are [1, u, exp(-(t - start)/lag), 0, y]: what a first-order lag makes of
a line, "degree" 2. Times are in s; values and their noise in any one unit. Plain functions, typed, compiled below;
in one file, because numba renews a cached function only when its own file changes.
"""

# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray, IntArray

COLUMNS = 5
CHUNK = 64
MOST_ROUNDS = 6


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


def _merged(time_s: FloatArray, value: FloatArray, block: int, weight: float, price: float, lag_s: float) -> IntArray:
    """Edges, shape (k + 1,), of the pieces: blocks joined pairwise, the best pairs first, while that lowers the cost.

    The cost is the squares left times ``weight``, and ``price`` for each coefficient and each edge.
    """
    count = max(1, time_s.size // block)
    edges = np.arange(count + 1) * block
    edges[count] = time_s.size
    factors = np.zeros((count, COLUMNS, COLUMNS))
    costs = np.empty(count)
    for i in range(count):
        first, last = edges[i], edges[i + 1]
        centre_s = 0.5 * (time_s[first] + time_s[last - 1])
        add_rows(factors[i], time_s, value, first, last, centre_s, half_length(time_s, first, last), lag_s)
        costs[i] = best_degree(factors[i], last - first, weight, price)[0]
    # what joining a piece with the next one adds; NaN where it has to be found anew
    rise = np.full(count, np.nan)
    chosen = np.zeros(count, np.bool_)
    while count > 1:
        for i in range(count - 1):
            if np.isnan(rise[i]):
                joined = joined_factor(time_s, factors[i], factors[i + 1], edges[i], edges[i + 1], edges[i + 2], lag_s)
                cost = best_degree(joined, edges[i + 2] - edges[i], weight, price)[0]
                rise[i] = cost - costs[i] - costs[i + 1] - price
        rise[count - 1] = np.inf
        for i in range(count):
            before = i == 0 or (not chosen[i - 1] and rise[i] <= rise[i - 1])
            chosen[i] = rise[i] < 0.0 and before and rise[i] <= rise[min(i + 1, count - 1)]
        kept, i = 0, 0
        while i < count:
            edges[kept] = edges[i]
            if chosen[i]:
                factors[kept] = joined_factor(
                    time_s, factors[i], factors[i + 1], edges[i], edges[i + 1], edges[i + 2], lag_s
                )
                costs[kept] = costs[i] + costs[i + 1] + price + rise[i]
                rise[kept] = np.nan
                if kept > 0:
                    rise[kept - 1] = np.nan
                i += 2
            else:
                factors[kept], costs[kept], rise[kept] = factors[i], costs[i], rise[i]
                i += 1
            kept += 1
        edges[kept] = time_s.size
        if kept == count:
            break
        count = kept
    return edges[: count + 1].copy()


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


def _best_edge(
    time_s: FloatArray,
    value: FloatArray,
    chunks: FloatArray,
    first: int,
    low: int,
    high: int,
    last: int,
    weight: float,
    price: float,
    lag_s: float,
) -> tuple[float, int]:
    """Return the least cost of two pieces over rows first to last with their edge in low to high; and that edge."""
    centre_s, half_s = 0.5 * (time_s[first] + time_s[last - 1]), half_length(time_s, first, last)
    right = np.zeros((COLUMNS, COLUMNS))
    add_range(right, time_s, value, chunks, high, last, centre_s, half_s, lag_s)
    right_cost = np.empty(high - low + 1)
    right_cost[high - low] = best_degree(right, last - high, weight, price)[0]
    for edge in range(high - 1, low - 1, -1):
        add_rows(right, time_s, value, edge, edge + 1, centre_s, half_s, lag_s)
        right_cost[edge - low] = best_degree(right, last - edge, weight, price)[0]
    left = np.zeros((COLUMNS, COLUMNS))
    add_range(left, time_s, value, chunks, first, low, centre_s, half_s, lag_s)
    best, best_edge = np.inf, low
    for edge in range(low, high + 1):
        if edge > low:
            add_rows(left, time_s, value, edge - 1, edge, centre_s, half_s, lag_s)
        cost = best_degree(left, edge - first, weight, price)[0] + right_cost[edge - low]
        if cost < best:
            best, best_edge = cost, edge
    return best, best_edge


def _piece_factor(
    time_s: FloatArray, value: FloatArray, chunks: FloatArray, first: int, last: int, lag_s: float
) -> FloatArray:
    """Factor of rows first to last about their own centre."""
    factor = np.zeros((COLUMNS, COLUMNS))
    centre_s = 0.5 * (time_s[first] + time_s[last - 1])
    add_range(factor, time_s, value, chunks, first, last, centre_s, half_length(time_s, first, last), lag_s)
    return factor


def _refined(
    time_s: FloatArray,
    value: FloatArray,
    edges: IntArray,
    window: int,
    fewest: int,
    longest: int,
    weight: float,
    price: float,
    lag_s: float,
) -> IntArray:
    """Edges moved by up to ``window`` rows to where they cost least, and without pieces that cost more than they save.

    A piece of up to ``longest`` rows may go, to its two neighbours; none is left with fewer than ``fewest`` rows.
    """
    chunks = chunks_of(time_s, value, lag_s)
    edges = edges.copy()
    count = edges.size - 1
    costs = np.empty(count)
    for i in range(count):
        factor = piece_factor(time_s, value, chunks, edges[i], edges[i + 1], lag_s)
        costs[i] = best_degree(factor, edges[i + 1] - edges[i], weight, price)[0]
    for _ in range(MOST_ROUNDS):
        changed = False
        i = 0
        while i < count:
            first, last = edges[i], edges[i + 1]
            if count == 1 or last - first > longest:
                i += 1
                continue
            if 0 < i < count - 1:
                begin, end = edges[i - 1], edges[i + 2]
                cost, edge = best_edge(time_s, value, chunks, begin, first, last, end, weight, price, lag_s)
                gain = costs[i - 1] + costs[i] + costs[i + 1] + price - cost
            else:
                begin, end = (first, edges[i + 2]) if i == 0 else (edges[i - 1], last)
                edge = begin
                factor = piece_factor(time_s, value, chunks, begin, end, lag_s)
                cost = best_degree(factor, end - begin, weight, price)[0]
                gain = costs[i] + costs[i + 1 if i == 0 else i - 1] + price - cost
            if gain <= 0.0:
                i += 1
                continue
            changed = True
            if 0 < i < count - 1:
                edges[i] = edge
                for j in range(i + 1, count):
                    edges[j] = edges[j + 1]
                for j in range(i + 1, count - 1):
                    costs[j] = costs[j + 1]
                count -= 1
                for j in range(i - 1, i + 1):
                    factor = piece_factor(time_s, value, chunks, edges[j], edges[j + 1], lag_s)
                    costs[j] = best_degree(factor, edges[j + 1] - edges[j], weight, price)[0]
                i = max(0, i - 1)
            else:
                gone = 1 if i == 0 else i
                for j in range(gone, count):
                    edges[j] = edges[j + 1]
                for j in range(gone, count - 1):
                    costs[j] = costs[j + 1]
                count -= 1
                costs[gone - 1] = cost
                i = max(0, gone - 1)
        for i in range(1, count):
            first, here, last = edges[i - 1], edges[i], edges[i + 1]
            low, high = max(here - window, first + fewest), min(here + window, last - fewest)
            if high <= low:
                continue
            cost, edge = best_edge(time_s, value, chunks, first, low, high, last, weight, price, lag_s)
            if edge != here and cost < costs[i - 1] + costs[i] - 1.0e-9 * abs(cost):
                edges[i] = edge
                for j in range(i - 1, i + 1):
                    factor = piece_factor(time_s, value, chunks, edges[j], edges[j + 1], lag_s)
                    costs[j] = best_degree(factor, edges[j + 1] - edges[j], weight, price)[0]
                changed = True
        if not changed:
            break
    return edges[: count + 1].copy()


def _fitted(
    time_s: FloatArray, value: FloatArray, edges: IntArray, weight: float, price: float, lag_s: float
) -> tuple[FloatArray, IntArray]:
    """Factors, shape (k, 5, 5), of the pieces about their own centres, and their degrees, shape (k,)."""
    chunks = chunks_of(time_s, value, lag_s)
    count = edges.size - 1
    factors = np.empty((count, COLUMNS, COLUMNS))
    degrees = np.empty(count, np.int64)
    for i in range(count):
        factors[i] = piece_factor(time_s, value, chunks, edges[i], edges[i + 1], lag_s)
        degrees[i] = best_degree(factors[i], edges[i + 1] - edges[i], weight, price)[1]
    return factors, degrees


def _lines(time_s: FloatArray, value: FloatArray, tolerance: float) -> IntArray:
    """Edges, shape (k + 1,), of the longest runs of rows that a line from their first meets within ``tolerance``."""
    edges = np.empty(time_s.size + 1, np.int64)
    edges[0] = 0
    count, first = 1, 0
    low, high = -np.inf, np.inf
    for i in range(1, time_s.size):
        after_s = time_s[i] - time_s[first]
        rise = value[i] - value[first]
        low, high = max(low, (rise - tolerance) / after_s), min(high, (rise + tolerance) / after_s)
        if low > high:
            edges[count] = i
            count += 1
            first = i
            low, high = -np.inf, np.inf
    edges[count] = time_s.size
    return edges[: count + 1].copy()


rotate_in = njit(cache=True, error_model="numpy")(_rotate_in)
add_rows = njit(cache=True, error_model="numpy")(_add_rows)
add_factor = njit(cache=True, error_model="numpy")(_add_factor)
decay_over = njit(cache=True, error_model="numpy")(_decay)
half_length = njit(cache=True, error_model="numpy")(_half_length)
joined_factor = njit(cache=True, error_model="numpy")(_joined_factor)
best_degree = njit(cache=True, error_model="numpy")(_best_degree)
merged: Callable[[FloatArray, FloatArray, int, float, float, float], IntArray]
merged = njit(cache=True, error_model="numpy")(_merged)
chunks_of = njit(cache=True, error_model="numpy")(_chunks)
add_range = njit(cache=True, error_model="numpy")(_add_range)
best_edge = njit(cache=True, error_model="numpy")(_best_edge)
piece_factor = njit(cache=True, error_model="numpy")(_piece_factor)
refined: Callable[[FloatArray, FloatArray, IntArray, int, int, int, float, float, float], IntArray]
refined = njit(cache=True, error_model="numpy")(_refined)
fitted: Callable[[FloatArray, FloatArray, IntArray, float, float, float], tuple[FloatArray, IntArray]]
fitted = njit(cache=True, error_model="numpy")(_fitted)
lines: Callable[[FloatArray, FloatArray, float], IntArray]
lines = njit(cache=True, error_model="numpy")(_lines)
