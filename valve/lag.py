"""The answer of a first-order lag to straight lines and steps, as straight lines between close corners."""

from __future__ import annotations

import math

import numpy as np

from valve.waveform import FloatArray


def lagged(
    time_s: FloatArray, target: FloatArray, start: float, lag_s: float, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Corners of the answer y' = (target - y) / lag_s that starts at ``start`` at the first time, to ``tolerance``.

    Two equal times make a step. Without a lag it is the target itself, its first value included.
    """
    if lag_s == 0.0:
        return time_s, target
    times, values = [time_s[:1]], [np.array([start])]
    for i in range(time_s.size - 1):
        duration_s = float(time_s[i + 1] - time_s[i])
        if duration_s <= 0.0:
            continue
        slope = float(target[i + 1] - target[i]) / duration_s
        after_s, lagging = _line_response(
            float(values[-1][-1]), duration_s, float(target[i]), slope, lag_s=lag_s, tolerance=tolerance
        )
        times.append(time_s[i] + after_s)
        values.append(lagging)
    joined_s = np.concatenate(times)
    joined_s[-1] = time_s[-1]
    return joined_s, np.concatenate(values)


def _line_response(
    start: float, duration_s: float, first: float, slope: float, *, lag_s: float, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Times after the start and values of the lagged answer to one line, the start left out.

    y(t) = u(t) - a T + (y_0 - u_0 + a T) exp(-t/T) for u(t) = u_0 + a t. A chord of length h leaves it by at most
    h^2/8 max|y''|, so corners are even in exp(-t/2T): the closest at the start and wider as the exponential dies.
    """
    swing = start - first + slope * lag_s
    # Number of chords from t = 0 to the end: the integral of sqrt(|y''| / (8 tolerance)) over t.
    root = math.sqrt(abs(swing) / (8.0 * tolerance))
    end = math.exp(-duration_s / (2.0 * lag_s))
    # sqrt(2): where chords are as long as T, |y''| at a chord's start is up to twice the mean that this counts with.
    chords = max(1, math.ceil(math.sqrt(2.0) * 2.0 * root * (1.0 - end)))
    share = np.linspace(1.0, max(end, math.exp(-18.0)), chords + 1)[1:]
    after_s = -2.0 * lag_s * np.log(share)
    if end < math.exp(-18.0):
        after_s = np.append(after_s, duration_s)
    after_s[-1] = duration_s
    return after_s, first + slope * (after_s - lag_s) + swing * np.exp(-after_s / lag_s)
