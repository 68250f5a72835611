"""The compiled search for runs of rows at one level: a stem at rest between its jumps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray, IntArray


def _level_runs(position_m: FloatArray, run_last: IntArray, limit_m: float, fewest: int) -> IntArray:
    """First and last rows, shape (k, 2), of runs within ``limit_m`` of their own mean, of at least ``fewest`` rows."""
    count = position_m.size
    runs = np.empty((count // fewest + 1, 2), np.int64)
    found, first = 0, 0
    while first < count:
        mean, rows, last = position_m[first], 1, first
        while last < run_last[first] and abs(position_m[last + 1] - mean) <= limit_m * np.sqrt(1.0 + 1.0 / rows):
            last += 1
            rows += 1
            mean += (position_m[last] - mean) / rows
        if rows >= fewest:
            runs[found, 0], runs[found, 1] = first, last
            found += 1
            first = last + 1
        else:
            first += 1
    return runs[:found].copy()


level_runs: Callable[[FloatArray, IntArray, float, int], IntArray]
level_runs = njit(cache=True, error_model="numpy")(_level_runs)
