"""Which samples of a valve in service are kept: the windows in which its stem moved, with what led to it and followed.

A stem that rests for hours says nothing. Around each motion five minutes before and one after are kept: the signal's
way to a breakaway belongs to it, as dead band and stick band are read there. Windows that meet become one.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
LEAD_S: Final = 300.0
TAIL_S: Final = 60.0
_NOISES: Final = 6.0  # standard deviations of one row: quarters are medians, so noise alone stays far below
_TRAVEL_SHARE: Final = 5.0e-4  # of rated travel: less is no slip that anybody judges
_REMEMBERED: Final = 60  # blocks by whose quietest the noise is known
_QUARTERS: Final = 4


class MovedWindows:
    """Takes the rows of one valve block by block, and hands out those to keep; arrays of shape (n, 4), time first.

    ``travel_m`` is the rated travel, None where nobody knows it. ``moved`` counts the blocks that moved.
    """

    def __init__(self, travel_m: float | None) -> None:
        self._least_m = 0.0 if travel_m is None else _TRAVEL_SHARE * travel_m
        self._noises: deque[float] = deque(maxlen=_REMEMBERED)
        self._level_m = np.nan
        self._waiting: deque[FloatArray] = deque()  # blocks that a motion may still make worth keeping
        self._keep_until_s = -np.inf
        self.moved = 0

    def take(self, rows: FloatArray) -> FloatArray:
        """Return the rows to keep now, those that waited and led to a motion before them; none: shape (0, 4).

        ``rows``: shape (n, 4), in s, m, Pa and Pa.
        """
        if self._has_moved(rows):
            self.moved += 1
            kept = [*self._waiting, rows]
            self._waiting.clear()
            self._keep_until_s = rows[-1, 0] + TAIL_S
            return np.concatenate(kept)
        if rows[0, 0] <= self._keep_until_s:
            return rows
        self._waiting.append(rows)
        while self._waiting and self._waiting[0][-1, 0] < rows[-1, 0] - LEAD_S:
            self._waiting.popleft()
        return rows[:0]

    def _has_moved(self, rows: FloatArray) -> bool:
        position_m = rows[:, 1][np.isfinite(rows[:, 1])]
        if position_m.size < 2 * _QUARTERS:
            return False
        second = np.abs(np.diff(position_m, 2))
        self._noises.append(1.4826 * float(np.median(second)) / np.sqrt(6.0))
        least_m = max(_NOISES * min(self._noises), self._least_m)
        levels_m = np.array([np.median(part) for part in np.array_split(position_m, _QUARTERS)])
        if not np.isfinite(self._level_m):
            self._level_m = float(levels_m[0])
        if float(np.max(np.abs(levels_m - self._level_m))) <= least_m:
            return False
        self._level_m = float(levels_m[-1])
        return True
