"""The compiled answer of a first-order lag to straight lines and steps, as straight lines between close corners."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray

MOST_CHORDS = 4096


def _chords(swing: float, duration: float, tolerance: float) -> int:
    """Number of chords for the exponential swing exp(-t) over ``duration``, a power of two.

    A chord of length h leaves a curve by at most h^2/8 of its second derivative; even in exp(-t/2) all leave it
    alike, so their number is the integral of sqrt(|swing| exp(-t) / (8 tolerance)); twice that where chords are as
    long as the lag. A power of two, so that it hardly ever changes with the lag: differences stay smooth.
    """
    wanted = 2.0 * math.sqrt(2.0) * math.sqrt(abs(swing) / (8.0 * tolerance)) * (1.0 - math.exp(-0.5 * duration))
    chords = 1
    while chords < wanted and chords < MOST_CHORDS:
        chords *= 2
    return chords


def _lagged(
    time_s: FloatArray, target: FloatArray, start: float, lag_s: float, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Corners of P' = (target - P)/lag from P = ``start`` at the first time, to within ``tolerance``.

    Over a line u0 + a t: P(t) = u0 + a (t - lag) + (P0 - u0 + a lag) exp(-t/lag).
    """
    capacity = 2 * time_s.size + 1
    level = start
    for i in range(time_s.size - 1):
        run_s = time_s[i + 1] - time_s[i]
        if run_s > 0.0:
            slope = (target[i + 1] - target[i]) / run_s
            swing = level - target[i] + slope * lag_s
            capacity += chords_of(swing, run_s / lag_s, tolerance)
            level = target[i + 1] - slope * lag_s + swing * math.exp(-run_s / lag_s)
    at_s, value = np.empty(capacity), np.empty(capacity)
    at_s[0], value[0] = time_s[0], start
    count, level = 1, start
    for i in range(time_s.size - 1):
        run_s = time_s[i + 1] - time_s[i]
        if run_s <= 0.0:
            continue
        slope = (target[i + 1] - target[i]) / run_s
        swing = level - target[i] + slope * lag_s
        chords = chords_of(swing, run_s / lag_s, tolerance)
        # beyond it the exponential is below the tolerance
        least = math.sqrt(tolerance / max(abs(swing), tolerance))
        last = math.exp(-0.5 * run_s / lag_s)
        # chords lie on one side of the curve, by swing apart^2 / 2 at the most: two thirds of it back, and their mean
        # is right
        apart = (1.0 - max(last, 0.5 * least)) / chords
        back = swing * apart * apart / 3.0
        for number in range(1, chords):
            share = 1.0 - number * apart
            after_s = -2.0 * lag_s * math.log(share)
            at_s[count] = time_s[i] + after_s
            value[count] = target[i] + slope * (after_s - lag_s) + swing * share * share - back
            count += 1
        if last < 0.5 * least:
            # where the exponential ends its line begins: one corner there, the next at the line's end
            after_s = -2.0 * lag_s * math.log(0.5 * least)
            at_s[count] = time_s[i] + after_s
            value[count] = target[i] + slope * (after_s - lag_s)
            value[count] += swing * math.exp(-after_s / lag_s)
            count += 1
        level = target[i + 1] - slope * lag_s + swing * last * last
        at_s[count], value[count] = time_s[i + 1], level
        count += 1
    return at_s[:count].copy(), value[:count].copy()


chords_of = njit(cache=True, error_model="numpy")(_chords)
lagged: Callable[[FloatArray, FloatArray, float, float, float], tuple[FloatArray, FloatArray]]
lagged = njit(cache=True, error_model="numpy")(_lagged)
