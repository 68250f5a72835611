"""Pauses of a stick-slip whose stem gives elastically: it creeps between its jumps, and no rest is seen in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray, IntArray, Samples

# Own choices, in shares of the mean speed.
_PAUSING: Final = 0.25
_JUMPING: Final = 2.0
_INNER: Final = 0.75  # of a usual pause
_MOSTLY: Final = 0.5  # of the rows between two jumps are slow: a slide that shakes is none
_GONE_NOISES: Final = 4.5  # that a stem must have left its pause by to be gone, as for rests (estimators.motion.rests)


@dataclass(frozen=True, slots=True)
class RestEnd:
    """The end of a rest: its last ``row``, the first of the rest, the direction of what follows, and its place, m."""

    row: int
    first: int
    direction: float
    rest_m: float


def rest_ends(motion: RecordedMotion) -> list[RestEnd]:
    """Return the ends of rests by breakaways; by what lies between two jumps where that tells of more of them.

    A noisy position is seen to move only over windows into which a short rest between two slips vanishes.
    """
    lasts = np.array([stretch.last for stretch in motion.phases.stretches])
    seen = []
    for one in motion.phases.breakaways:
        before = lasts[lasts < one.row]
        seen.append(RestEnd(one.row, int(before[-1]) if before.size else 0, float(one.direction), float(one.rest_m)))
    between = _left_pauses(motion)
    return between if len(between) > len(seen) else seen


def _left_pauses(motion: RecordedMotion) -> list[RestEnd]:
    samples, (found, _, leaving) = motion.samples, _between_jumps(motion)
    ends = []
    for rows, direction in zip(found, leaving, strict=True):
        rest_m = float(np.median(samples.position_m[rows]))
        # a window tells the jump's beginning too early: the last row that is not away from the pause is later
        until = min(int(rows[-1]) + 2 * max(motion.phases.half_window, 1) + 1, samples.count)
        way_m = direction * (samples.position_m[rows[rows.size // 2] : until] - rest_m)
        still = np.flatnonzero(way_m <= _GONE_NOISES * samples.position_noise_m)
        row = int(rows[rows.size // 2]) + (int(still[-1]) if still.size else 0)
        ends.append(RestEnd(row, int(rows[0]), direction, rest_m))
    return ends


def pauses(motion: RecordedMotion) -> tuple[IntArray, FloatArray, FloatArray]:
    """Middle rows, positions there, m, and directions of arrival of what lies between two jumps of the stem."""
    found, sense, _ = _between_jumps(motion)
    return np.array([rows[rows.size // 2] for rows in found], np.int64), _places(motion.samples, found, sense), sense


def _between_jumps(motion: RecordedMotion) -> tuple[list[IntArray], FloatArray, list[float]]:
    """Rows of each pause between two jumps, and the directions of the jump before, shape (n,), and of that after."""
    samples, phases = motion.samples, motion.phases
    half = max(phases.half_window, 1)
    # a running mean keeps a position that creeps evenly
    mean_m = np.convolve(samples.position_m, np.ones(2 * half + 1) / (2 * half + 1), mode="same")
    inner = slice(half, samples.count - half)
    way_m = float(np.abs(np.diff(mean_m[inner][::half])).sum())
    usual = way_m / max(float(samples.time_s[-1] - samples.time_s[0]), 1.0e-9)
    speed = np.abs(phases.velocity)
    jumping = np.flatnonzero(speed > _JUMPING * usual)
    if jumping.size == 0:
        return [], np.empty(0), []
    ends = np.flatnonzero(np.diff(jumping) > 1)
    found: list[IntArray] = []
    senses: list[float] = []
    leaving: list[float] = []
    for before, after in zip(jumping[ends], jumping[ends + 1], strict=True):
        slow = before + 1 + np.flatnonzero(speed[before + 1 : after] < _PAUSING * usual)
        if slow.size >= max(half, _MOSTLY * (after - before)):
            found.append(np.asarray(slow, dtype=np.int64))
            senses.append(float(np.sign(phases.velocity[before])))
            leaving.append(float(np.sign(phases.velocity[after])))
    return found, np.array(senses), leaving


def _places(samples: Samples, pauses_rows: list[IntArray], sense: FloatArray) -> FloatArray:
    """Positions at the middles of pauses, m: means of the rows about them without what a bent creep adds.

    Pauses creep alike, so that their median bend towards each direction is known far better than any one's.
    """
    if not pauses_rows:
        return np.empty(0)
    count = max(5, round(_INNER * float(np.median([rows.size for rows in pauses_rows]))))
    means, bends, squares = [], [], []
    for rows in pauses_rows:
        first = max((rows.size - count) // 2, 0)
        inner = rows[first : first + count]
        off_s = samples.time_s[inner] - samples.time_s[rows[rows.size // 2]]
        off_s -= off_s.mean()
        means.append(float(samples.position_m[inner].mean()))
        bends.append(float(np.polyfit(off_s, samples.position_m[inner], 2)[0]) if inner.size > 2 else 0.0)
        squares.append(float(np.mean(off_s**2)))
    bend = float(np.median(sense * np.array(bends)))
    return np.asarray(np.array(means) - bend * sense * np.array(squares))
