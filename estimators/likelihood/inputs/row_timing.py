"""What is not known of the instants of a polled test, as an error of its positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d

from estimators.samples import FloatArray, IntArray
from valve.recording import Recording

_UNIFORM: Final = 1.0 / float(np.sqrt(12.0))  # one standard deviation of a time that lies anywhere in an interval
# Own choices. A late write is over with its tread and the two after it; slower than this share of the fastest is rest.
_TREADS: Final = 3
_SLOW: Final = 1.0e-2


@dataclass(frozen=True, slots=True, eq=False)
class PositionDoubts:
    """One standard deviation of each row's position by the doubt in its instants, m, and of it what stays, (n,).

    ``lasting_m`` is one error of all rows of a rest: what the writes before it leave unknown of where the stem stopped.
    """

    total_m: FloatArray
    lasting_m: FloatArray


def look_doubts_s(recording: Recording, rows: IntArray) -> FloatArray:
    """One standard deviation of the instant at which each of these rows was taken, s; 0 where the file says nothing.

    The device took the sample at some time between the request and the answer.
    """
    if recording.sent_s is None or recording.received_s is None:
        return np.zeros(rows.size)
    return np.asarray(_UNIFORM * np.nan_to_num((recording.received_s - recording.sent_s)[rows]))


def write_doubts_s(recording: Recording, rows: IntArray) -> FloatArray:
    """One standard deviation of the instant at which these rows' command came into force, s; 0 where none is recorded.

    A row that wrote none has the doubt of the write before it.
    """
    if recording.write_sent_s is None or recording.written_s is None:
        return np.zeros(rows.size)
    lasted_s = recording.written_s - recording.write_sent_s
    wrote = np.isfinite(lasted_s)
    last = np.maximum.accumulate(np.where(wrote, np.arange(lasted_s.size), -1))
    return np.asarray(_UNIFORM * np.where(last >= 0, lasted_s[np.maximum(last, 0)], 0.0)[rows])


def position_doubts(recording: Recording, time_s: FloatArray, position_m: FloatArray, noise_m: float) -> PositionDoubts:
    """Return the doubts of the positions, before any motion is simulated: the speed about a row times the times' doubt.

    Of the row's own write and the two before it the longest counts, and the fastest of the rows that they moved. A rest
    keeps what its last row in motion had.
    """
    none = np.zeros(time_s.size)
    if recording.received_s is None and recording.written_s is None:
        return PositionDoubts(none, none)
    rows = np.searchsorted(recording.time_s, time_s)
    look_s, write_s = look_doubts_s(recording, rows), write_doubts_s(recording, rows)
    if not (look_s.any() or write_s.any()) or time_s.size < 2 * _TREADS:
        return PositionDoubts(none, none)
    speed = np.abs(np.diff(position_m) / np.diff(time_s))
    before, after = np.concatenate([speed[:1], speed]), np.concatenate([speed, speed[-1:]])
    seen_m = look_s * np.sqrt(0.5 * (before**2 + after**2))
    # the window reaches back: a filter's origin moves it
    origin = (_TREADS - 1) // 2
    longest_s = maximum_filter1d(write_s, _TREADS, origin=origin)
    fastest = np.maximum(maximum_filter1d(before, _TREADS, origin=origin), after)
    written_m = longest_s * fastest
    still = still_rows(position_m, noise_m)
    last = np.maximum.accumulate(np.where(still, -1, np.arange(time_s.size)))
    lasting_m = np.where(still & (last >= 0), written_m[np.maximum(last, 0)], 0.0)
    seen_m, written_m = np.where(still, 0.0, seen_m), np.where(still, lasting_m, written_m)
    return PositionDoubts(np.hypot(seen_m, written_m), lasting_m)


def still_rows(position_m: FloatArray, noise_m: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Rows, shape (n,), from which and to which the stem did not move by more than noise or a trifle of its pace."""
    change_m = np.abs(np.diff(position_m))
    moved = change_m > max(6.0 * noise_m, _SLOW * float(np.quantile(change_m, 0.9)))
    return np.asarray(~(np.concatenate([[False], moved]) | np.concatenate([moved, [False]])))


def shared_by_rest(
    still: np.ndarray[tuple[int], np.dtype[np.bool_]], total_m: FloatArray, lasting_m: FloatArray
) -> FloatArray:
    """Weight of each row, (n,), as a share of that of a row whose error ``total_m`` is its own.

    n rows of a rest that have the error ``lasting_m`` in common tell n / (1 + (n - 1) lasting^2/total^2) times what one
    does.
    """
    share = np.ones(still.size)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    for first, end in zip(edges[0::2], edges[1::2], strict=True):
        ratio = (lasting_m[first:end] / np.maximum(total_m[first:end], 1.0e-300)) ** 2
        share[first:end] = 1.0 / np.sqrt(1.0 + (end - first - 1.0) * ratio)
    return share
