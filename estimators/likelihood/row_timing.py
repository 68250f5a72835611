"""What is not known of the instants of a polled test, as an error of its positions."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.samples import FloatArray, IntArray
from valve.recording import Recording

_UNIFORM: Final = 1.0 / float(np.sqrt(12.0))  # one standard deviation of a time that lies anywhere in an interval


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


def position_doubts_m(recording: Recording, time_s: FloatArray, position_m: FloatArray) -> FloatArray:
    """One standard deviation of the positions, shape (n,), from the doubt of their instants: |v| times it.

    |v| is the rms of the speeds before and after the row. The write and the look are in doubt independently.
    """
    rows = np.searchsorted(recording.time_s, time_s)
    doubt_s = np.hypot(look_doubts_s(recording, rows), write_doubts_s(recording, rows))
    if not doubt_s.any():
        return np.zeros(time_s.size)
    square = (np.diff(position_m) / np.diff(time_s)) ** 2
    mean_square = 0.5 * (np.concatenate([square[:1], square]) + np.concatenate([square, square[-1:]]))
    return np.asarray(doubt_s * np.sqrt(mean_square))
