"""Rests and moves of a valve in service: a move is real only beyond what noise and resolution explain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.compiled import kernel_of
from estimators.in_service.rows import Rows
from valve.recording import FloatArray

IntArray = np.ndarray[tuple[int, ...], np.dtype[np.int64]]

# Own choices, tried on simulated loops at 1, 10 and 50 Hz (tests/bench/benchmarks/in_service.py).
_LEAVE_SIGMAS: Final = 5.0  # a row that far from the level of a rest has left it, if the next one has, too
_AT_REST_SIGMAS: Final = 2.5  # a row that near is at rest still
_REST_S: Final = 0.25  # a rest lasts at least so long
_MOST_LEVEL_ROWS: Final = 400  # rows of a rest's level: a gauge that drifts over hours is followed

DRIVEN_BANDS: Final = 3.0  # times the band that a sliding stem would have gone in a rest, or it may have slid
_DRIVEN_BLOCKS: Final = 8

_kernel = kernel_of(__file__)


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Moves between two rests of one run, arrays of shape (n_moves,).

    ``left``: last row at the old level, ``reached``: first row at the new one; ``from_level`` and ``to_level`` in the
    position's unit; ``began`` and ``ended``: direction at the breakaway and at the stop, +1 or -1, which differ where
    the stem turned without a rest; ``rest_first``: first row of the rest before. ``band``: a smaller change is noise.
    """

    left: IntArray
    reached: IntArray
    from_level: FloatArray
    to_level: FloatArray
    began: IntArray
    ended: IntArray
    rest_first: IntArray
    band: float

    @property
    def count(self) -> int:
        """Number of moves."""
        return int(self.left.size)


@_kernel
def _rests(
    position: FloatArray, run: IntArray, limits: tuple[float, float, float], least: int, most: int
) -> tuple[IntArray, IntArray, FloatArray, int]:
    """First and last row and level of each rest, and their number."""
    leave, near, still = limits
    count = position.size
    first, last = np.empty(count, np.int64), np.empty(count, np.int64)
    level = np.empty(count)
    found = 0
    row = 0
    while row + least <= count:
        # a rest begins where the next rows stay together
        low = high = position[row]
        total = 0.0
        together = True
        for ahead in range(row, row + least):
            value = position[ahead]
            low, high = min(low, value), max(high, value)
            total += value
            if run[ahead] != run[row] or high - low > still:
                together = False
                break
        if not together:
            row += 1
            continue
        begin, weight, mean = row, least, total / least
        at = row + least
        while at < count and run[at] == run[begin]:
            off = position[at] - mean
            if abs(off) > leave:
                ends = at + 1 >= count or run[at + 1] != run[begin] or abs(off) > 2.5 * leave
                if ends or ((position[at + 1] - mean) * off > 0.0 and abs(position[at + 1] - mean) > leave):
                    break
            else:
                weight = min(weight + 1, most)
                mean += off / weight
            at += 1
        end = at - 1
        while end > begin and abs(position[end] - mean) > near:
            end -= 1
        first[found], last[found], level[found] = begin, end, mean
        found += 1
        row = end + 1
    return first, last, level, found


@_kernel
def _crossings(
    position: FloatArray,
    run: IntArray,
    rests: tuple[IntArray, IntArray],
    level: FloatArray,
    limits: tuple[float, float],
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """For each pair of neighbouring rests the row that reaches the new level, and the directions; 0 across a gap."""
    (first, last), (near, turn) = rests, limits
    pairs = first.size - 1
    reached, before = np.empty(pairs, np.int64), np.empty(pairs, np.int64)
    began, ended = np.zeros(pairs, np.int64), np.zeros(pairs, np.int64)
    for pair in range(pairs):
        left, next_first = last[pair], first[pair + 1]
        reached[pair], before[pair] = next_first, left
        if run[left] != run[next_first]:
            continue
        low = high = position[left]
        for row in range(left, next_first + 1):
            low, high = min(low, position[row]), max(high, position[row])
        old, new = level[pair], level[pair + 1]
        arrived = next_first
        while arrived - 1 > left and abs(position[arrived - 1] - new) <= near:
            arrived -= 1
        reached[pair] = arrived
        sign = 1 if new > old else -1
        over = high - max(old, new) if sign > 0 else min(old, new) - low  # beyond the new level
        under = min(old, new) - low if sign > 0 else high - max(old, new)  # beyond the old one
        began[pair] = -sign if under > turn else sign
        ended[pair] = -sign if over > turn else sign
    return reached, before, began, ended


def no_moves(band: float) -> Moves:
    """Return no move at all."""
    nothing = np.empty(0, np.int64)
    return Moves(nothing, nothing, np.empty(0), np.empty(0), nothing, nothing, nothing, band)


def moves_of(rows: Rows) -> Moves:
    """Return the moves between rests; a valve that never moved beyond its noise has none."""
    sigma = max(rows.noise, 1.0e-9 * float(np.abs(rows.position).max()))
    least = max(2, math.ceil(_REST_S / rows.period_s))
    still = (3.5 + 0.7 * math.log(least)) * sigma * 1.15
    leave = _LEAVE_SIGMAS * sigma
    first, last, level, count = _rests(
        rows.position, rows.run, (leave, _AT_REST_SIGMAS * sigma, still), least, _MOST_LEVEL_ROWS
    )
    first, last, level = _joined(first[:count], last[:count], level[:count], rows.run, leave)
    if first.size < 2:
        return no_moves(leave)
    reached, left, began, ended = _crossings(
        rows.position, rows.run, (first, last), level, (_AT_REST_SIGMAS * sigma, 2.0 * leave)
    )
    real = began != 0
    return Moves(
        left[real],
        reached[real],
        level[:-1][real],
        level[1:][real],
        began[real],
        ended[real],
        first[:-1][real],
        leave,
    )


def driven_by(rows: Rows, first: IntArray, last: IntArray) -> FloatArray:
    """How far the signal went in each rest, first and last rows of shape (n,), beyond what its noise explains.

    The range of eight means, so that a noisy gauge drives nothing.
    """
    total = np.concatenate([[0.0], np.cumsum(rows.signal - rows.signal[0])])
    count = last - first + 1
    blocks = np.minimum(_DRIVEN_BLOCKS, count)
    edges = (
        first[:, None] + np.minimum(np.arange(_DRIVEN_BLOCKS + 1), blocks[:, None]) * count[:, None] // blocks[:, None]
    )
    rows_in = np.diff(edges, axis=1)
    sums = total[edges[:, 1:]] - total[edges[:, :-1]]
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(rows_in > 0, sums / rows_in, np.nan)
    spread = np.nanmax(means, axis=1) - np.nanmin(means, axis=1)
    explained = 3.0 * rows.signal_noise * np.sqrt(blocks / count) * (blocks > 1)
    return np.asarray(np.maximum(spread - explained, 0.0))


def without_false_rests(moves: Moves, rows: Rows, spring: float) -> Moves:
    """Join moves of one direction between which the stem may have slid on as well.

    There the signal changed by less than what moves a sliding stem by three bands. ``spring``: signal by position.
    """
    if moves.count < 2 or spring <= 0.0:
        return moves
    driven = driven_by(rows, moves.reached[:-1], np.maximum(moves.left[1:], moves.reached[:-1]))
    joins = (
        (moves.ended[:-1] == moves.began[1:])
        & (rows.run[moves.reached[:-1]] == rows.run[moves.left[1:]])
        & (moves.rest_first[1:] <= moves.reached[:-1] + 1)
        & (driven < DRIVEN_BANDS * spring * moves.band)
    )
    begins = np.concatenate([[True], ~joins])
    ends = np.concatenate([~joins, [True]])
    return Moves(
        moves.left[begins],
        moves.reached[ends],
        moves.from_level[begins],
        moves.to_level[ends],
        moves.began[begins],
        moves.ended[ends],
        moves.rest_first[begins],
        moves.band,
    )


def _joined(
    first: IntArray, last: IntArray, level: FloatArray, run: IntArray, band: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Join neighbours of the same level, of one run: what lies between them was a spike."""
    firsts: list[int] = []
    lasts: list[int] = []
    levels: list[float] = []
    for begin, end, at in zip(first.tolist(), last.tolist(), level.tolist(), strict=True):
        if levels and run[lasts[-1]] == run[begin] and abs(at - levels[-1]) <= 0.8 * band:
            rows, own = lasts[-1] - firsts[-1] + 1, end - begin + 1
            levels[-1] = (levels[-1] * rows + at * own) / (rows + own)
            lasts[-1] = end
            continue
        firsts.append(begin)
        lasts.append(end)
        levels.append(at)
    return np.array(firsts, np.int64), np.array(lasts, np.int64), np.array(levels)
