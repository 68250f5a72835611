"""Slope of a noisy channel by the means on either side of a row."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray, IntArray, Samples


def windowed_slope(samples: Samples, channel: FloatArray, half_window: int) -> FloatArray:
    """Slope of a channel, any unit, per second, shape (n,): mean of the rows after less that before, over their times.

    Each mean holds ``half_window`` + 1 rows, the row itself in both; less at the ends of a run.
    """
    return _slope(samples.time_s, channel, samples.run_first, samples.run_last, half_window)


def windowed_slope_noise(noise: float, half_window: int, period_s: float) -> float:
    """Standard deviation of the slope that white noise of the channel makes, per second."""
    return noise * math.sqrt(2.0 * half_window) / ((half_window + 1) * half_window * period_s)


def _slope_of_rows(
    time_s: FloatArray, channel: FloatArray, run_first: IntArray, run_last: IntArray, half_window: int
) -> FloatArray:
    count = time_s.size
    slope = np.zeros(count)
    start_s, level = time_s[0], channel[0]
    times, values = np.zeros(count + 1), np.zeros(count + 1)
    for row in range(count):
        times[row + 1] = times[row] + (time_s[row] - start_s)
        values[row + 1] = values[row] + (channel[row] - level)
    for row in range(count):
        low = max(row - half_window, run_first[row])
        high = min(row + half_window, run_last[row])
        after, before = high - row + 1, row - low + 1
        run_s = (times[high + 1] - times[row]) / after - (times[row + 1] - times[low]) / before
        if run_s > 0.0:
            rise = (values[high + 1] - values[row]) / after - (values[row + 1] - values[low]) / before
            slope[row] = rise / run_s
    return slope


_slope: Callable[[FloatArray, FloatArray, IntArray, IntArray, int], FloatArray] = njit(cache=True)(_slope_of_rows)
