"""Blocks of rows that hold all that a recording says of a slip: single rows about its events, longer ones later."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np

from estimators.motion.phases import After
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray, IntArray

# Own choices: rows that stand alone after an event, and how much longer a block may be for each row of age.
_ALONE: Final = 16
_SHARE_OF_AGE: Final = 0.06
_DOUBT: Final = 4.0  # times the uncertainty of a breakaway's instant
_MOST_DOUBT_S: Final = 0.5
_DOUBTFUL_BLOCKS: Final = 60
_BEFORE_A_CORNER: Final = 3


def block_firsts(motion: RecordedMotion) -> IntArray:
    """First rows of the blocks, shape (b,), the first of them 0; none reaches over an event or a gap."""
    samples, phases = motion.samples, motion.phases
    doubts = {breakaway.row + 1: breakaway for breakaway in phases.breakaways}
    begins = {0: _ALONE}
    for row in np.flatnonzero(np.diff(samples.run_first)).tolist():
        begins[row + 1] = _ALONE
    for stretch in phases.stretches:
        begins.setdefault(max(0, stretch.last - _BEFORE_A_CORNER), _ALONE)
        breakaway = doubts.get(stretch.first) if stretch.after is After.BREAKAWAY else None
        if breakaway is None:
            begins.setdefault(max(0, stretch.first - _BEFORE_A_CORNER), _ALONE)
            continue
        pad_s = min(_DOUBT * breakaway.within_s + 2.0 * samples.period_s, _MOST_DOUBT_S)
        edges_s = [breakaway.time_s - pad_s, breakaway.time_s + pad_s]
        early, late = np.searchsorted(samples.time_s, edges_s).tolist()
        early = min(early, stretch.first)
        begins[early] = max(late, stretch.first) - early
    order = sorted(begins)
    parts = [_growing(begin, end, begins[begin]) for begin, end in zip(order, [*order[1:], samples.count], strict=True)]
    return np.concatenate(parts)


def _growing(begin: int, end: int, doubtful: int) -> IntArray:
    """First rows from ``begin`` to before ``end``: even ones while it is doubtful, then longer with age."""
    step = 1 + doubtful // _DOUBTFUL_BLOCKS
    even = np.arange(begin, min(begin + doubtful, end), step, dtype=np.int64)
    rest = end - begin - doubtful
    if rest <= 0:
        return even
    ages = _ages(1 << math.ceil(math.log2(rest + 1)))
    return np.concatenate([even, begin + doubtful + ages[ages < rest]])


@cache
def _ages(most: int) -> IntArray:
    """Rows after an event at which blocks begin."""
    found, age = [], 0
    while age < most:
        found.append(age)
        age += max(1, int(_SHARE_OF_AGE * (age - _ALONE)))
    return np.array(found, dtype=np.int64)


def block_means(values: FloatArray, firsts: IntArray) -> FloatArray:
    """Mean of each block, shape (b,)."""
    rows = np.diff(np.append(firsts, values.size))
    return np.asarray(np.add.reduceat(values, firsts) / rows)
