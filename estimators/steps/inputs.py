"""Steps of the input in a recording: when each began, between which levels, and how long the last one was held."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.samples import BoolArray, FloatArray, IntArray, channel_noise

# Own choices.
_FEWEST_ROWS: Final = 6  # of a hold
_LEVEL_SIGMAS: Final = 5.0
_SLOWEST_RISE: Final = 0.2  # of the hold that follows: what takes longer to 63 % is no step
_QUICK_RISE: Final = 0.05  # of the hold: as good as a step, whatever its shape
_RAMP_SHAPE: Final = 1.8  # time to 95 % over time to 63 %: 1.5 of a straight line, 3.0 of a lag
_LEVEL_SHARE: Final = 2.0e-4  # of the input's range: what a level may wander
_SMALLEST_STEP: Final = 5.0e-4  # of the input's range
_LEAST_HOLD_S: Final = 0.3  # a staircase with shorter treads is a ramp in an output's resolution


@dataclass(frozen=True, slots=True)
class InputStep:
    """The input goes from ``before`` to ``after``; all rows count the complete samples.

    It is initiated between rows ``row`` (the last at the old level) and ``row`` + 1: at ``time_s`` to within half
    of ``sample_s``. Held from ``row`` + 1 to ``last``; the old level is held from ``first`` to ``row``.
    """

    first: int
    row: int
    last: int
    time_s: float
    sample_s: float
    before: float
    after: float

    @property
    def size(self) -> float:
        """Change of the input, in its unit."""
        return self.after - self.before


def find_steps(time_s: FloatArray, level: FloatArray, run_first: IntArray) -> list[InputStep]:
    """Return the steps of an input ``level``, shape (n,), between holds; an input that ramps or waves has none.

    ``level`` is in any unit. ``run_first``, shape (n,), is the first row of each row's run without a gap; a step across
    a gap is left out.
    """
    holds = _holds(time_s, level, run_first)
    smallest = _SMALLEST_STEP * float(np.ptp(level)) if level.size else 0.0
    steps = []
    for (first, row), (begin, last) in pairwise(holds):
        if run_first[row] != run_first[begin]:
            continue
        before, after = float(np.median(level[first : row + 1])), float(np.median(level[begin : last + 1]))
        if abs(after - before) <= smallest or _is_ramp(
            time_s[row : begin + 1], level[row : begin + 1], float(time_s[last])
        ):
            continue
        sample_s = float(time_s[row + 1] - time_s[row])
        steps.append(InputStep(first, row, last, float(time_s[row]) + sample_s / 2.0, sample_s, before, after))
    return steps


def _is_ramp(time_s: FloatArray, level: FloatArray, held_until_s: float) -> bool:
    """Whether the input went straight or slowly from its old level to the new one, rather than by a step or a lag."""
    if level.size <= 3:
        return False
    share = (level - level[0]) / (level[-1] - level[0])
    most_s, all_s = (float(time_s[int(np.argmax(share >= part))] - time_s[0]) for part in (0.632, 0.95))
    hold_s = held_until_s - float(time_s[0])
    if most_s <= _QUICK_RISE * hold_s:
        return False
    return most_s > _SLOWEST_RISE * hold_s or all_s < _RAMP_SHAPE * most_s


def _holds(time_s: FloatArray, level: FloatArray, run_first: IntArray) -> list[tuple[int, int]]:
    """First and last row of each stretch at one level, neighbours at different levels."""
    noise = channel_noise(time_s, level, run_first)
    reach = float(np.ptp(level))
    if level.size < 3 * _FEWEST_ROWS or reach <= 12.0 * noise:
        return []
    still = _still(level, run_first, _LEVEL_SIGMAS * noise + _LEVEL_SHARE * reach)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    holds: list[tuple[int, int]] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - first < _FEWEST_ROWS or time_s[end - 1] - time_s[first] < _LEAST_HOLD_S:
            continue
        if holds and first - holds[-1][1] <= 3 and run_first[holds[-1][1]] == run_first[first]:
            rows_0, rows_1 = slice(holds[-1][0], holds[-1][1] + 1), slice(first, end)
            counts = min(rows_0.stop - rows_0.start, end - first)
            apart = abs(float(np.median(level[rows_1])) - float(np.median(level[rows_0])))
            if apart <= 1.25 * _LEVEL_SIGMAS * noise * np.sqrt(2.0 / counts) + 1.0e-6 * reach:
                holds[-1] = (holds[-1][0], end - 1)
                continue
        holds.append((first, end - 1))
    return holds


def _still(level: FloatArray, run_first: IntArray, limit: float) -> BoolArray:
    """Rows, shape (n,), about which the level stays: to the next row, and over the next _FEWEST_ROWS in the mean."""
    count = level.size
    leap = np.zeros(count, dtype=np.bool_)
    leap[1:] = (np.abs(np.diff(level)) > limit) | (run_first[1:] != run_first[:-1])
    # pieces between leaps are holds unless they drift
    firsts = np.concatenate([[0], np.flatnonzero(leap)])
    ends = np.concatenate([firsts[1:], [count]])
    still = np.zeros(count, dtype=np.bool_)
    for first, end in zip(firsts.tolist(), ends.tolist(), strict=True):
        size = end - first
        if size < _FEWEST_ROWS:
            continue
        # a piece may begin with the rise of a lagging pressure: keep its end, as far back as it is level
        block = max(1, size // 64)
        blocks = size // block
        means = level[end - blocks * block : end].reshape(blocks, block).mean(axis=1)
        final = float(means[-max(1, blocks // 8) :].mean())
        off = np.flatnonzero(np.abs(means - final) > limit / np.sqrt(min(block, 25)) + 0.2 * limit)
        begin = first if off.size == 0 else end - (blocks - 1 - int(off[-1])) * block
        still[begin:end] = True
        still[first] = False  # pieces stay apart
    return still
