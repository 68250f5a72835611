"""A command over the gaps of its recording: the I/P answers what was commanded meanwhile, and the stem moves on."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.likelihood.lines.stretches import Corners, KnownCorners, Stretch, is_long_gap
from estimators.samples import FloatArray

_SAME: Final = 1.0e-6  # of the span of both: one line on both sides of a gap


def over_gaps(
    stretches: tuple[Stretch, ...], breaks_s: FloatArray, period_s: float
) -> tuple[tuple[Stretch, ...], FloatArray]:
    """Return the stretches, those in one that go on from one another, and the breaks, shape (n, 2), s, that are left.

    A ramp that is one line on both sides goes on through any gap. Two lines that meet within a short one have their
    corner there. Two holds with a gap between them may be of two recordings that were put together.
    """
    kept, left = list(stretches[:1]), []
    for (begin_s, end_s), after in zip(breaks_s.tolist(), stretches[1:], strict=True):
        before = kept[-1]
        drawn = None
        if isinstance(before, KnownCorners) and isinstance(after, KnownCorners):
            drawn = _drawn(before.corners(), after.corners(), is_short=not is_long_gap(end_s - begin_s, period_s))
        if drawn is None:
            kept.append(after)
            left.append((begin_s, end_s))
        else:
            kept[-1] = KnownCorners(*drawn)
    return tuple(kept), np.array(left).reshape(-1, 2)


def _drawn(before: Corners, after: Corners, *, is_short: bool) -> Corners | None:
    """Return both as one polyline, with the corner of the gap if it has one; None where they do not go on."""
    begin_s, end_s = float(before[0][-1]), float(after[0][0])
    first, second = _slope(before, -1), _slope(after, 0)
    if first == second == 0.0:
        return None
    span = max(float(np.ptp(np.concatenate([before[1], after[1]]))), math.ulp(0.0))
    off = float(after[1][0] - before[1][-1]) - first * (end_s - begin_s)  # of the first line where the second begins
    bend = (second - first) * (end_s - begin_s)
    if max(abs(off), abs(bend)) <= _SAME * span:
        return np.concatenate([before[0], after[0]]), np.concatenate([before[1], after[1]])
    share = 1.0 - off / bend if bend != 0.0 else math.inf
    if not is_short or not 0.0 <= share <= 1.0:
        return None
    corner_s = begin_s + share * (end_s - begin_s)
    corner = float(before[1][-1]) + first * (corner_s - begin_s)
    return np.concatenate([before[0], [corner_s], after[0]]), np.concatenate([before[1], [corner], after[1]])


def _slope(part: Corners, line: int) -> float:
    """Return the slope of this line of a stretch, 1/s; 0 of one row alone and of a step."""
    time_s, value = part
    took_s, rise = np.diff(time_s), np.diff(value)
    return float(rise[line] / took_s[line]) if took_s.size and took_s[line] > 0.0 else 0.0
