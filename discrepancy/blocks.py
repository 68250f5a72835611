"""Which rows of a recording are averaged into one block: all where the stem moves evenly, none where it is fast."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.motion.phases import Phases
from estimators.motion.windowed_slope import windowed_slope_noise
from estimators.samples import BoolArray, IntArray, Samples

# Own choices, from valves without and with hidden effects (docs/diagnosis.md).
_FINE_S: Final = 5.0e-3  # rows are averaged over so long where nothing fast happens
_COARSE_S: Final = 1.0e-2  # and over so long where the fine means show no more than noise between them
_MORE_THAN_NOISE: Final = 4.0  # standard deviations of the mean square of second differences
_FAST_MARGIN_S: Final = 0.02
_SURE: Final = 4.0  # standard deviations of a windowed velocity's change
_ENOUGH: Final = 100


class Blocks:
    """The blocks of one recording."""

    def __init__(self, samples: Samples, phases: Phases, noise_m: float, longest_s: float = math.inf) -> None:
        """Find where this motion is fast beside the sensor's noise, m; no block is longer than ``longest_s``."""
        length_s = min(_length(samples, phases, noise_m), longest_s)
        self._samples, self._rows = samples, max(1, round(length_s / samples.period_s))
        self._fast = _fast(samples, phases, noise_m, length_s)

    def between(self, first: int, end: int) -> IntArray:
        """Return the first rows of the blocks from ``first`` to ``end``, shape (b,): single rows where it is fast."""
        rows = np.arange(first, end)
        fast = self._fast[rows]
        begins = fast | np.concatenate([[True], fast[:-1]])
        begins |= self._samples.run_first[rows] == rows
        since = rows - np.maximum.accumulate(np.where(begins, rows, first))
        return np.asarray(rows[since % self._rows == 0], dtype=np.int64)


def _length(samples: Samples, phases: Phases, noise_m: float) -> float:
    """Return the length of the blocks, s: coarse unless the fine ones' second differences are more than noise.

    A vibration that noise hides there is weak; at 30 Hz a coarse mean still holds 0.86 of it.
    """
    rows = max(1, round(_FINE_S / samples.period_s))
    fast = _fast(samples, phases, noise_m, _FINE_S)
    blocks = samples.count // rows
    if blocks < _ENOUGH:
        return _FINE_S
    mean_m = samples.position_m[: blocks * rows].reshape(blocks, rows).mean(axis=1)
    is_fast: BoolArray = np.asarray(fast[: blocks * rows].reshape(blocks, rows).any(axis=1))
    slow = ~(is_fast[:-2] | is_fast[1:-1] | is_fast[2:])
    second = (mean_m[:-2] - 2.0 * mean_m[1:-1] + mean_m[2:])[slow]
    if second.size < _ENOUGH:
        return _FINE_S
    ratio = float(np.mean(second**2)) * rows / (6.0 * noise_m**2)
    # overlapping differences: the variance of their mean square is that of 0.51 times as many independent ones
    return _FINE_S if ratio > 1.0 + _MORE_THAN_NOISE * math.sqrt(2.0 / (0.51 * second.size)) else _COARSE_S


def _fast(samples: Samples, phases: Phases, noise_m: float, block_s: float) -> BoolArray:
    """Rows, shape (n,), where a block's mean would not lie on the motion: about ends of motion and in slips."""
    margin = max(1, round(_FAST_MARGIN_S / samples.period_s))
    marks = np.zeros(samples.count + 1)
    edges = [edge for stretch in phases.stretches for edge in (stretch.first, stretch.last)]
    half = max(phases.half_window, 1)
    change = np.zeros(samples.count)
    change[half:-half] = np.abs(phases.velocity[2 * half :] - phases.velocity[: -2 * half])
    error = math.sqrt(2.0) * windowed_slope_noise(noise_m, half, samples.period_s)
    # a kink of the velocity by dv puts a block's mean off by up to dv T/8
    steep = max(_SURE * error, 8.0 * noise_m / block_s * math.sqrt(samples.period_s / block_s))
    for edge in [*edges, *np.flatnonzero(change > steep).tolist()]:
        marks[max(0, edge - margin)] += 1.0
        marks[min(samples.count, edge + margin)] -= 1.0
    return np.asarray(np.cumsum(marks)[:-1] > 0.0)
