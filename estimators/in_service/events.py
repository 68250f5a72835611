"""What each move says of the force: at its breakaway, at its stop, and while the stem slid in between.

A stem that is damped, as valves with packing are, comes to rest when the force has fallen to the friction in motion:
signal = k x + F_0 + s F at the end of a slip, and signal = k x + F_0 + s F_s where it broke away.
Romano & Garcia (2007), Eq. (1) and (2), without inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from estimators.in_service.moves import IntArray, Moves, driven_by
from estimators.in_service.rows import BoolArray, Rows
from valve.recording import FloatArray

_SETTLED_S: Final = 0.3  # after a breakaway: slips of heavy valves and filters of sensors are over
_ENOUGH: Final = 8  # stops, or slides, in each direction: then they need no help of the other kind
_FEWEST_SLIDING: Final = 3  # rows of a slide
_SLIDE_BANDS: Final = 1.5  # way of a slide from its first third to its last
_LARGEST_STEP: Final = 0.5  # of the way of a slide, from row to row: more is a slip
_LIKE_SPRING: Final = 0.4  # of what the spring takes on the way
_PIECE_BANDS: Final = 10.0  # of a slide: longer ones are cut, friction differs along the travel
_MOST_AVERAGED_S: Final = 0.06  # on either side of an instant: a gauge's noise is averaged where rows are fast


class Kind(IntEnum):
    """What the stem did at an observation."""

    MOTION = 0
    BREAKAWAY = 1


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Arrays of shape (n,): where the stem was, the signal then, and by how much that may be off.

    ``sign``: direction of the motion. ``half_width``: rows leave the signal at the instant open by as much.
    ``move``: number of the move. ``driven``: by how much the signal changed in the rest before, at a breakaway.
    ``slid``: the mean of a slide.
    """

    time_s: FloatArray
    position: FloatArray
    signal: FloatArray
    half_width: FloatArray
    sign: IntArray
    kind: IntArray
    move: IntArray
    driven: FloatArray
    slid: BoolArray

    @property
    def count(self) -> int:
        """Number of observations."""
        return int(self.time_s.size)

    def chosen(self, keep: BoolArray) -> Observations:
        """Return those that ``keep``, shape (n,), selects."""
        return Observations(
            self.time_s[keep],
            self.position[keep],
            self.signal[keep],
            self.half_width[keep],
            self.sign[keep],
            self.kind[keep],
            self.move[keep],
            self.driven[keep],
            self.slid[keep],
        )


def observations_of(rows: Rows, moves: Moves, spring: float | None = None) -> Observations:
    """Return what the moves say; ``spring``, signal by position, tells a slide from a slip where it is known."""
    slides = _slides(rows, moves, spring)
    parts = [_breakaways(rows, moves), _stops(rows, moves, slides[6]), slides]
    slid = np.arange(sum(part[0].size for part in parts)) >= parts[0][0].size + parts[1][0].size
    time_s, position, signal, half_width = (np.concatenate([part[at] for part in parts]) for at in range(4))
    sign, kind, move = (np.concatenate([part[at] for part in parts]) for at in (4, 5, 6))
    driven = np.concatenate([part[7] for part in parts])
    return Observations(time_s, position, signal, half_width, sign, kind, move, driven, slid)


def of_one_motion(seen: Observations) -> Observations:
    """Return the observations with stops alone, or slides alone, where there are more of them and enough.

    A slide has its speed's viscous friction on top, and a creeping stem's stops come early: mixed they disagree.
    """
    motion = seen.kind == Kind.MOTION
    stops, slides = motion & ~seen.slid, motion & seen.slid
    more, fewer = (stops, slides) if stops.sum() >= slides.sum() else (slides, stops)
    enough = all((more & (seen.sign == sign)).sum() >= _ENOUGH for sign in (1, -1))
    return seen.chosen(~fewer) if enough else seen


Columns = tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray, IntArray, IntArray, FloatArray]


def _breakaways(rows: Rows, moves: Moves) -> Columns:
    """Force between the last row at rest and the next."""
    at = moves.left
    signal, half = _between(rows, at, moves.began)
    kind = np.full(at.size, Kind.BREAKAWAY, np.int64)
    driven = driven_by(rows, moves.rest_first, np.maximum(at, moves.rest_first))
    return rows.time_s[at], moves.from_level, signal, half, moves.began, kind, np.arange(at.size), driven


def _is_slip(rows: Rows, moves: Moves) -> BoolArray:
    """Whether the stem was at its new level at once, one row later or before what follows a breakaway is over."""
    took_s = rows.time_s[moves.reached] - rows.time_s[moves.left]
    return np.asarray((moves.reached - moves.left <= 2) | (took_s <= _SETTLED_S))


def _stops(rows: Rows, moves: Moves, slid: IntArray) -> Columns:
    """Force where a slip ends: between the last row under way and the first at the new level."""
    slips = np.setdiff1d(np.arange(moves.count), slid)
    at = moves.reached[slips] - 1
    signal, half = _between(rows, at, moves.ended[slips])
    kind = np.full(at.size, Kind.MOTION, np.int64)
    none = np.full(at.size, np.nan)
    return rows.time_s[moves.reached[slips]], moves.to_level[slips], signal, half, moves.ended[slips], kind, slips, none


def _slides(rows: Rows, moves: Moves, spring: float | None) -> Columns:
    """Means over stretches in which the stem slid on, after what follows a breakaway is over."""
    found: list[tuple[float, float, float, float, int, int]] = []
    for number in np.flatnonzero((moves.began == moves.ended) & ~_is_slip(rows, moves)):
        left, reached, sign = int(moves.left[number]), int(moves.reached[number]), int(moves.began[number])
        first = max(left + 2, int(np.searchsorted(rows.time_s, rows.time_s[left] + _SETTLED_S)))
        if reached - first < _FEWEST_SLIDING:
            continue
        pieces = math.ceil(abs(rows.position[reached - 1] - rows.position[first]) / (_PIECE_BANDS * moves.band))
        for part in np.array_split(
            np.arange(first, reached), max(1, min(pieces, (reached - first) // _FEWEST_SLIDING))
        ):
            if _is_slide(rows, part, sign, moves.band, spring):
                means = [float(channel[part].mean()) for channel in (rows.time_s, rows.position, rows.signal)]
                found.append((means[0], means[1], means[2], 0.0, sign, int(number)))
    columns = np.array(found, np.float64).reshape(-1, 6).T
    kind = np.full(columns.shape[1], Kind.MOTION, np.int64)
    none = np.full(columns.shape[1], np.nan)
    sign_of, number_of = columns[4].astype(np.int64), columns[5].astype(np.int64)
    return columns[0], columns[1], columns[2], columns[3], sign_of, kind, number_of, none


def _is_slide(rows: Rows, part: IntArray, sign: int, band: float, spring: float | None) -> bool:
    """Whether the stem slid in these rows, driven by the signal, and neither rested, slipped nor coasted.

    A sliding stem goes as far as the signal's change moves its spring.
    """
    third = max(1, part.size // 3)
    first, last = part[:third], part[-third:]
    went = sign * float(rows.position[last].mean() - rows.position[first].mean())
    if went < _SLIDE_BANDS * band:
        return False
    steps = sign * np.diff(rows.position[part])
    if float(steps.max()) > _LARGEST_STEP * float(np.ptp(rows.position[part])) + band:
        return False
    if spring is None:
        return True
    driven = sign * float(rows.signal[last].mean() - rows.signal[first].mean())
    noise = 3.0 * rows.signal_noise * math.sqrt(2.0 / third)
    return abs(driven - spring * went) <= _LIKE_SPRING * spring * went + noise


def _between(rows: Rows, at: IntArray, sign: IntArray) -> tuple[FloatArray, FloatArray]:
    """Signal between the rows ``at`` and the next, and half of what is left open; fast rows are averaged.

    A controller turns the signal when the stem has slipped: then it was higher between slow rows than in either, at
    most where the lines through the rows before and after meet.
    """
    last = rows.signal.size - 1
    before, after = rows.signal[at], rows.signal[at + 1]
    step_s = rows.time_s[at + 1] - rows.time_s[at]

    def slope(one: IntArray, other: IntArray) -> FloatArray:
        apart_s = rows.time_s[other] - rows.time_s[one]
        near = (apart_s > 0.0) & (rows.run[one] == rows.run[other])
        rise = rows.signal[other] - rows.signal[one]
        return np.asarray(np.where(near, sign * rise / np.where(near, apart_s, 1.0), 0.0))

    rising, falling = slope(np.maximum(at - 1, 0), at), slope(at + 1, np.minimum(at + 2, last))
    meets = (rising > 0.0) & (falling < 0.0)
    low, high = sign * before, sign * after
    peak_s = np.where(meets, (high - low - falling * step_s) / np.where(meets, rising - falling, 1.0), 0.0)
    peak = low + rising * np.clip(peak_s, 0.0, step_s)
    top = np.where(meets, np.maximum(np.maximum(low, high), peak), np.maximum(low, high))
    bottom = np.where(meets, np.minimum(low, top), np.minimum(low, high))
    middle, half = sign * 0.5 * (bottom + top), 0.5 * (top - bottom)
    width = math.floor(_MOST_AVERAGED_S / rows.period_s)
    if width >= 2 and at.size:
        total = np.concatenate([[0.0], np.cumsum(rows.signal - rows.signal[0])])
        first, end = np.maximum(at - width + 1, 0), np.minimum(at + 1 + width, rows.signal.size)
        middle = rows.signal[0] + (total[end] - total[first]) / (end - first)
        half = np.minimum(half, 2.0 * rows.signal_noise)
    return np.asarray(middle), np.asarray(half)
