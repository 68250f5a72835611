"""The compiled search for the fewest pieces, lines up to cubics, that a noisy channel allows.

Times are in s; values and their noise in any one unit; ``lag_s`` is that of the factors. Plain functions, typed,
compiled below.
"""

# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from estimators.compiled import kernel_of
from estimators.likelihood.lines import piece_factors
from estimators.likelihood.lines.piece_factors import (
    COLUMNS,
    add_range,
    add_rows,
    best_degree,
    chunks_of,
    half_length,
    joined_factor,
    piece_factor,
)
from estimators.samples import FloatArray, IntArray

MOST_ROUNDS = 6


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


_compiled = kernel_of(piece_factors.__file__, __file__)
merged: Callable[[FloatArray, FloatArray, int, float, float, float], IntArray] = _compiled(_merged)
best_edge = _compiled(_best_edge)
refined: Callable[[FloatArray, FloatArray, IntArray, int, int, int, float, float, float], IntArray]
refined = _compiled(_refined)
fitted: Callable[[FloatArray, FloatArray, IntArray, float, float, float], tuple[FloatArray, IntArray]]
fitted = _compiled(_fitted)
lines: Callable[[FloatArray, FloatArray, float], IntArray] = _compiled(_lines)
