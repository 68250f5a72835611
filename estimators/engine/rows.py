"""Which rows of a recording were measured, without drop-outs and one of each value held; and what they follow on from.

Several recordings of one valve come as one, with a gap in time between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import FEWEST_SAMPLES
from estimators.samples import BoolArray, FloatArray, IntArray
from valve.recording import Recording

_DROP_OUT_S: Final = 0.15  # at most
_SLOWEST_S: Final = 0.04  # between rows: in slower ones a stem that turns looks like it
_DROP_OUT_SHARE: Final = 0.04  # of the position's range, there and back
_BACK_SHARE: Final = 0.3  # of the excursion: how far from where it left the position comes back
_HELD_SHARE: Final = 0.6  # of the rows repeat the one before
_GAP_PERIODS: Final = 6.0  # a shorter gap is bridged: a slot or two that were missed
_LEAST_GAP_S: Final = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredRows:
    """The recording with the rows that were measured, its clock from 0 on, and what was left out."""

    recording: Recording
    dropped: int
    held: int  # rows that each value stands for; 1 where none is held


def measured_rows(recording: Recording) -> MeasuredRows:
    """Return the rows that were measured; a recording that is whole stays as it is."""
    lost = _drop_outs(recording.time_s, recording.position_m)
    kept = recording.rows(~lost)
    held = _held(kept)
    if held > 1:
        kept = kept.rows(_one_of_each(kept, held))
    shifted = Recording(
        kept.time_s - kept.time_s[0], kept.position_m, kept.pressure_pa, kept.command_pa, kept.force_n,
        provenance=kept.provenance,
    )  # fmt: skip
    return MeasuredRows(shifted, int(lost.sum()), held)


def runs_between_gaps(time_s: FloatArray) -> tuple[IntArray, IntArray]:
    """First and last row of each row's run without a long gap, shape (n,) each."""
    step_s = np.diff(time_s)
    usual_s = float(np.median(step_s)) if step_s.size else 0.0
    edges = np.flatnonzero(step_s > max(_GAP_PERIODS * usual_s, _LEAST_GAP_S)) + 1
    firsts, lasts = np.concatenate([[0], edges]), np.concatenate([edges - 1, [time_s.size - 1]])
    lengths = lasts - firsts + 1
    return np.repeat(firsts, lengths), np.repeat(lasts, lengths)


def _drop_outs(time_s: FloatArray, position_m: FloatArray) -> BoolArray:
    """Rows of a short run of one value that the position jumps to and back from."""
    lost = np.zeros(time_s.size, dtype=np.bool_)
    if time_s.size < 3 or float(np.median(np.diff(time_s))) > _SLOWEST_S:
        return lost
    range_m = float(np.nanmax(position_m) - np.nanmin(position_m)) if np.isfinite(position_m).any() else 0.0
    jump_m = _DROP_OUT_SHARE * range_m
    edges = np.flatnonzero(np.abs(np.diff(position_m)) > jump_m)
    for left, right in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        inside = position_m[left + 1 : right + 1]
        before, after = float(position_m[left]), float(position_m[right + 1])
        away = abs(float(inside[0]) - before)
        level = bool((inside == inside[0]).all())
        if level and time_s[right] - time_s[left] <= _DROP_OUT_S and abs(after - before) < _BACK_SHARE * away:
            lost[left + 1 : right + 1] = True
    return lost


def _same_as_before(recording: Recording) -> BoolArray:
    """Whether a row repeats the position of the one before, shape (n,)."""
    return np.concatenate([[False], np.diff(recording.position_m) == 0.0])


def _held(recording: Recording) -> int:
    """How many rows each value stands for, 1 where the device does not hold them."""
    same = _same_as_before(recording)
    if float(same.mean()) < _HELD_SHARE or not recording.is_evenly_sampled:
        return 1
    lengths = np.diff(np.append(np.flatnonzero(~same), same.size))
    numbers, counts = np.unique(lengths, return_counts=True)
    usual = int(numbers[np.argmax(counts)])
    # a position that hardly changes at all is held by the stem
    is_device = counts.max() > 0.5 * lengths.size and same.size >= FEWEST_SAMPLES * usual
    return usual if is_device else 1


def _one_of_each(recording: Recording, held: int) -> BoolArray:
    """The first row of each value; a value that stays for longer is taken as often as it was renewed."""
    same = _same_as_before(recording)
    first = np.maximum.accumulate(np.where(same, 0, np.arange(same.size)))
    return np.asarray((np.arange(same.size) - first) % held == 0)
