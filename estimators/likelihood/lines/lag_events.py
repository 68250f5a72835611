"""Where a pressure behind a first-order lag bends or steps: the cheapest pieces for some lags."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.likelihood.lines.piece_kernel import fitted, merged, refined
from estimators.samples import BoolArray, FloatArray, IntArray

# Own choices, tried on triangles, multi-rate triangles and steps behind lags of 0.02 to 1 s at 1-50 ms.
_MOST_ROWS: Final = 3500  # of the search for the events
_LAGS: Final = 8
_LONGEST_LAG_S: Final = 3.0
_MOST_EVENTS: Final = 100
_CLOSER: Final = 6  # times that the lag of the search is brought closer
_HOPELESS: Final = 1.5  # times the cost without a lag
_PRICE: Final = 1.3


def search_events(
    time_s: FloatArray, value: FloatArray, noise: float
) -> tuple[float, FloatArray, FloatArray, BoolArray, FloatArray] | None:
    """Lag, event times, first coefficients, which events are steps, and their sizes: the cheapest of some lags."""
    rows = max(1, time_s.size // _MOST_ROWS)
    count = time_s.size // rows
    coarse_s = time_s[: count * rows].reshape(count, rows).mean(axis=1)
    coarse = value[: count * rows].reshape(count, rows).mean(axis=1)
    weight, price = rows / noise**2, _PRICE * math.log(max(count, 8))
    longest = max(64, count // 50)

    def cut(lag_s: float, *, fully: bool = True) -> tuple[float, IntArray]:
        edges = merged(coarse_s, coarse, 3, weight, price, lag_s)
        if fully:
            edges = refined(coarse_s, coarse, edges, 10, 3, longest, weight, price, lag_s)
        factors, degree = fitted(coarse_s, coarse, edges, weight, price, lag_s)
        left = sum(float(np.sum(f[d + 1 :, 4] ** 2)) for f, d in zip(factors, degree, strict=True))
        return weight * left + price * float(np.sum(degree + 2)), edges

    shortest_s = max(2.0 * float(coarse_s[1] - coarse_s[0]), 0.01)
    tried = [
        (*cut(float(lag_s), fully=False), float(lag_s)) for lag_s in np.geomspace(shortest_s, _LONGEST_LAG_S, _LAGS)
    ]
    cost, edges, lag_s = min(tried, key=lambda trial: trial[0])
    if cost > _HOPELESS * cut(0.0, fully=False)[0]:
        return None
    cost, edges = cut(lag_s)
    ratio = (_LONGEST_LAG_S / shortest_s) ** (1.0 / (_LAGS - 1))
    for _ in range(_CLOSER):
        ratio = math.sqrt(ratio)
        near = [(cost, edges, lag_s)] + [(*cut(other_s), other_s) for other_s in (lag_s / ratio, lag_s * ratio)]
        cost, edges, lag_s = min(near, key=lambda trial: trial[0])
    if cost >= cut(0.0)[0] or not 0 < edges.size - 2 <= _MOST_EVENTS:
        return None
    factors, _ = fitted(coarse_s, coarse, edges, weight, price, lag_s)
    return lag_s, *_events(coarse_s, edges, factors, lag_s)


def _events(
    time_s: FloatArray, edges: IntArray, factors: FloatArray, lag_s: float
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray]:
    """Times of the events, level, slope and swing at the start, which events are steps, and sizes as pressures."""
    first_s, last_s = time_s[edges[:-1]], time_s[edges[1:] - 1]
    centre_s, half_s = 0.5 * (first_s + last_s), 0.5 * (last_s - first_s)
    lines = np.array([np.linalg.pinv(factor[:3, :3]) @ factor[:3, 4] for factor in factors])
    slope = lines[:, 1] / half_s
    at_s = 0.5 * (first_s[1:] + last_s[:-1])
    # what the lag follows is its steady answer, earlier by the lag
    one = lines[:-1, 0] + slope[:-1] * (at_s - centre_s[:-1] + lag_s)
    two = lines[1:, 0] + slope[1:] * (at_s - centre_s[1:] + lag_s)
    bend, jump = slope[1:] - slope[:-1], two - one
    steps = np.abs(jump) > np.abs(bend) * max(lag_s, 10.0 * float(time_s[1] - time_s[0]))
    start = np.array([lines[0, 0] + slope[0] * (time_s[0] - centre_s[0]), slope[0], lines[0, 2]])
    return at_s, start, np.asarray(steps, dtype=np.bool_), np.abs(bend) * lag_s + np.where(steps, np.abs(jump), 0.0)
