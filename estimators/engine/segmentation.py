"""What the stem did: where it rested, where it broke away, slipped and slid, and where it turned without a rest.

A rest is a stretch on which the position stays within a band that noise explains while the force changes by several
times what it takes to drive a sliding stem across that band. So slow sliding is no rest, however noisy the sensor.
Jumps that are smaller than the band are not told apart from sliding: the friction that is seen there is an effective
one, between F_c and F_s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.compiled import kernel_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Own choices, tried on six valves from perfect to hard packing at 1 and 20 ms (tests/estimators/engine).
_SMOOTHED_S: Final = 0.004  # rows are averaged over this before a band is laid around them
_BAND_SIGMAS: Final = 7.0  # of the averaged white noise: the band that holds a rest
_QUIET_S: Final = 0.1  # windows of which the quietest are taken for rests, to read off how wide a band noise needs
_QUIETEST: Final = 12  # of such windows: the one of that rank is taken
_WIDER_THAN_QUIET: Final = 1.7
_DRIVEN: Final = 3.0  # times the band that a sliding stem would have gone while a resting one stays within it
_HALT_DRIVEN: Final = 6.0  # the same between two moves of one direction: friction along the travel slows a stem, too
_HALT_S: Final = 0.04  # and the least time: the tail of a sensor's filter looks like a rest before the rest
_STANDS: Final = 0.1  # of the way that it is driven, from the first third of a halt to its last
_AGAIN: Final = 5  # halts in a row, between which the stem only went on
_TAIL_GOES: Final = 5.0  # bands at most, in the time that it took for one
_DWELL_S: Final = 0.25  # with a force that does not change a stem that stays in the band so long is at rest
_SAME_LEVEL: Final = 0.6  # of the band: rests that near to each other with nothing between are one
_FEWEST_ROWS: Final = 3
_MOST_DRIFT: Final = 0.35  # of the band, from the first third of a rest to its last: a stem that creeps drifts by 2/3

_kernel = kernel_of(__file__)


@dataclass(frozen=True, slots=True)
class Rest:
    """The stem is at rest from row ``first`` to ``last`` at ``level_m``, known to ``error_m``."""

    first: int
    last: int
    level_m: float
    error_m: float


@dataclass(frozen=True, slots=True)
class Move:
    """Motion in one direction (+1, -1), rows ``first`` to ``last``; ``rest`` and ``next_rest`` number the rests.

    They are -1 where the stem did not rest: at the ends of the recording, and where it turned at once. ``began_s`` is
    when it broke away, NaN without a rest before it.
    """

    first: int
    last: int
    direction: int
    rest: int
    next_rest: int
    began_s: float
    distance_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """Rests and moves in the order of time; ``band_m`` is what noise hides."""

    rests: tuple[Rest, ...]
    moves: tuple[Move, ...]
    band_m: float

    @property
    def directions(self) -> set[int]:
        """Directions in which the stem moved."""
        return {move.direction for move in self.moves}

    @property
    def breakaways(self) -> tuple[Move, ...]:
        """Moves that began at a rest."""
        return tuple(move for move in self.moves if move.rest >= 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """The position as the steps of the segmentation see it, arrays of shape (n,)."""

    time_s: FloatArray
    position_m: FloatArray
    smooth_m: FloatArray
    driven_m: FloatArray
    pushed_m: FloatArray  # the force over a rough spring rate, 0 where it does not tell what the stem does
    run_last: IntArray
    band_m: float
    noise_m: float


@_kernel
def _reach(smooth: FloatArray, band: float, run_last: IntArray) -> IntArray:
    """For each row the last one such that all rows between lie within ``band`` of each other, in the same run."""
    count = smooth.size
    reach = np.empty(count, np.int64)
    high, low = np.empty(count, np.int64), np.empty(count, np.int64)  # queues of falling and of rising values
    high_first = high_end = low_first = low_end = 0
    end = 0  # first row that is not taken in yet
    for row in range(count):
        end = max(end, row)
        while end < count and end <= run_last[row]:
            top = smooth[high[high_first]] if high_end > high_first else smooth[end]
            bottom = smooth[low[low_first]] if low_end > low_first else smooth[end]
            if max(top, smooth[end]) - min(bottom, smooth[end]) > band:
                break
            while high_end > high_first and smooth[high[high_end - 1]] <= smooth[end]:
                high_end -= 1
            high[high_end] = end
            high_end += 1
            while low_end > low_first and smooth[low[low_end - 1]] >= smooth[end]:
                low_end -= 1
            low[low_end] = end
            low_end += 1
            end += 1
        reach[row] = max(row, end - 1)
        if high_end > high_first and high[high_first] == row:
            high_first += 1
        if low_end > low_first and low[low_first] == row:
            low_first += 1
    return reach


def moving_mean(values: FloatArray, width: int, run_last: IntArray | None = None) -> FloatArray:
    """Centred mean over an odd number of rows, shorter at the ends; shape (n,), any unit.

    ``run_last``: none across a gap.
    """
    half = width // 2
    if half == 0:
        return values
    total = np.concatenate([[0.0], np.cumsum(values - values[0])])
    row = np.arange(values.size)
    first, end = np.maximum(row - half, 0), np.minimum(row + half + 1, values.size)
    if run_last is not None:
        first, end = np.maximum(first, np.searchsorted(run_last, run_last)), np.minimum(end, run_last + 1)
    # as many on either side, or a slope would move the ends
    reach = np.minimum(row - first, end - row - 1)
    first, end = row - reach, row + reach + 1
    return np.asarray(values[0] + (total[end] - total[first]) / (end - first))


def _quiet_range(smooth: FloatArray, rows: int) -> float:
    """Range of the position in the quietest windows of this many rows."""
    windows = np.lib.stride_tricks.sliding_window_view(smooth, rows)[:: max(1, rows // 4)]
    ranges = np.sort(np.ptp(windows, axis=1))
    return float(ranges[min(_QUIETEST, ranges.size - 1)])


def segment(
    time_s: FloatArray,
    position_m: FloatArray,
    force_n: FloatArray,
    run_last: IntArray,
    *,
    noise_m: float,
    spring_n_per_m: float,
    is_commanded: bool = False,
) -> Segmentation:
    """Return rests and moves of a recording, arrays of shape (n,).

    ``noise_m`` is the white noise of one row; ``spring_n_per_m`` a rough spring rate, 0 for a drive without one:
    then it is the usual speed of the moving stem that a rest is held against. ``is_commanded``: the force is the
    command, and the stem's own comes later.
    """
    period_s = float(np.median(np.diff(time_s)))
    width = 2 * (max(1, round(_SMOOTHED_S / period_s)) // 2) + 1
    smooth = moving_mean(position_m, width, run_last)
    span_m = float(np.ptp(smooth))
    window = min(max(5, round(_QUIET_S / period_s)), max(5, time_s.size // 8))
    quiet_m = _quiet_range(smooth, window)
    white_m = _BAND_SIGMAS * noise_m / math.sqrt(width)
    band_m = max(white_m, min(_WIDER_THAN_QUIET * quiet_m, 4.0 * white_m), 1.0e-7 * span_m)
    driven_m = _driven(time_s, smooth, force_n, spring_n_per_m, band_m)
    tells = spring_n_per_m > 0.0 and not is_commanded
    pushed_m = force_n / spring_n_per_m if tells else np.zeros(time_s.size)
    track = _Track(time_s, position_m, smooth, driven_m, pushed_m, run_last, band_m, noise_m)
    rests = _joined(_rests(track, _rest_rows(track)), track)
    moves = _moves(track, rests)
    doubtful = _halts(track, rests, moves) | _in_tails(track, rests, moves)
    if doubtful:
        rests = [rest for number, rest in enumerate(rests) if number not in doubtful]
        moves = _moves(track, rests)
    return Segmentation(tuple(rests), tuple(moves), band_m)


def _halts(track: _Track, rests: list[Rest], moves: list[Move]) -> set[int]:
    """Numbers of the rests between two moves of one direction that may be a slower part of one motion.

    One in which the stem stands is none if it is long, or one of many in a row: a stem that slips.
    """
    before = {move.next_rest: move for move in moves if move.next_rest >= 0}
    after = {move.rest: move for move in moves if move.rest >= 0}
    between = [
        number in before and number in after and before[number].direction == after[number].direction
        for number in range(len(rests))
    ]
    standing = [one and _stands(track, rest) for one, rest in zip(between, rests, strict=True)]
    in_a_row = 0
    doubtful = set[int]()
    for number, rest in enumerate(rests):
        in_a_row = in_a_row + 1 if standing[number] else 0
        is_long = track.time_s[rest.last] - track.time_s[rest.first] >= _HALT_S
        driven_m = track.driven_m[rest.last] - track.driven_m[rest.first]
        if between[number] and not (is_long and (standing[number] or driven_m >= _HALT_DRIVEN * track.band_m)):
            doubtful.add(number)
        if in_a_row >= _AGAIN:
            doubtful.difference_update(range(number - in_a_row + 1, number + 1))
    return doubtful


def _in_tails(track: _Track, rests: list[Rest], moves: list[Move]) -> set[int]:
    """Numbers of the rests between two moves of one direction behind which the force has gone back.

    No stem that rested goes on for that: it is the tail of a reading that lags, and slows down. What jumps there is no
    tail: a sensor that slipped.
    """
    found = set[int]()
    for move, following in pairwise(moves):
        numbers = range(move.next_rest, following.rest + 1)
        if move.direction != following.direction or move.next_rest < 0 or not numbers:
            continue
        before, after = rests[numbers[0]], rests[numbers[-1]]
        back_m = -move.direction * _change(track.pushed_m[before.first : after.last + 1])
        later = min(2 * after.last - before.first, int(track.run_last[after.last]))
        gone_m = abs(float(track.smooth_m[later]) - after.level_m)
        if back_m > track.band_m and gone_m < _TAIL_GOES * track.band_m:
            found.update(numbers)
    return found


def _stands(track: _Track, rest: Rest) -> bool:
    """Whether a stem that is driven on goes by hardly any of it: roughness slows one, and hardly ever stops it."""
    driven_m = float(track.driven_m[rest.last] - track.driven_m[rest.first])
    values = track.position_m[rest.first : rest.last + 1]
    error_m = track.noise_m * math.sqrt(6.0 / values.size)  # of the difference between two thirds
    return _drift(values) + 2.0 * error_m < _STANDS * driven_m


def _driven(
    time_s: FloatArray, smooth: FloatArray, force_n: FloatArray, spring_n_per_m: float, band_m: float
) -> FloatArray:
    """How far a stem that slides would have gone up to each row, m, there and back counted both; shape (n,)."""
    if spring_n_per_m > 0.0:
        # steps of half a band or more only: the noise of a pressure goes to and fro without driving anything
        return np.asarray(_ratchet(force_n, 0.5 * band_m * spring_n_per_m) / spring_n_per_m)
    speed = np.abs(np.gradient(smooth, time_s))
    usual = float(np.median(speed[speed > 0.2 * np.quantile(speed, 0.95)])) if speed.any() else 0.0
    return np.asarray(0.3 * usual * (time_s - time_s[0]))


@_kernel
def _ratchet(values: FloatArray, play: float) -> FloatArray:
    """Way of a body that is drawn through a play of this size, up to each row."""
    way = np.empty(values.size)
    at, total = values[0], 0.0
    for row in range(values.size):
        if values[row] > at + play:
            total += values[row] - play - at
            at = values[row] - play
        elif values[row] < at - play:
            total += at - values[row] - play
            at = values[row] + play
        way[row] = total
    return way


def _rest_rows(track: _Track) -> list[tuple[int, int]]:
    """First and last rows of rests that do not overlap."""
    time_s, smooth, band_m = track.time_s, track.smooth_m, track.band_m
    reach = _reach(smooth, band_m, track.run_last)
    driven_m = track.driven_m[reach] - track.driven_m
    dwells = (time_s[reach] - time_s >= _DWELL_S) & (driven_m < 0.01 * band_m)
    is_rest = ((driven_m >= _DRIVEN * band_m) | dwells) & (reach - np.arange(time_s.size) >= _FEWEST_ROWS - 1)
    candidates = np.flatnonzero(is_rest)
    found: list[tuple[int, int]] = []
    at = 0
    while at < candidates.size:
        first = int(candidates[at])
        last = int(reach[first])
        level = float(np.median(smooth[first : last + 1]))
        inside = np.flatnonzero(np.abs(smooth[first : last + 1] - level) <= 0.5 * band_m)
        first, last = first + int(inside[0]), first + int(inside[-1])
        # a stem that sets off stays in the band for a row or two
        long_enough = last - first >= _FEWEST_ROWS - 1
        if long_enough and _drift(smooth[first : last + 1]) <= _MOST_DRIFT * band_m:
            found.append((first, last))
            at = int(np.searchsorted(candidates, last, side="right"))
        else:  # it creeps: a rest may begin further on
            at = int(np.searchsorted(candidates, max(first + max(1, (last - first) // 4), int(candidates[at]) + 1)))
    return found


def _change(values: FloatArray) -> float:
    """By how much the last third of the values lies above the first."""
    third = max(1, values.size // 3)
    return float(values[-third:].mean() - values[:third].mean())


def _drift(values: FloatArray) -> float:
    """How far the last third of the values lies from the first."""
    return abs(_change(values))


def _rests(track: _Track, spans: list[tuple[int, int]]) -> list[Rest]:
    rests = []
    for first, last in spans:
        margin = (last - first) // 5
        inner = track.position_m[first + margin : last - margin + 1]
        rests.append(Rest(first, last, float(inner.mean()), max(track.noise_m, 1.0e-12) / math.sqrt(inner.size)))
    return rests


def _joined(rests: list[Rest], track: _Track) -> list[Rest]:
    """Join neighbours that are one rest: the same level, and no excursion between them."""
    band_m = track.band_m
    joined: list[Rest] = []
    for rest in rests:
        before = joined[-1] if joined else None
        together = before is not None and track.run_last[before.last] >= rest.first
        if before is not None and together and abs(rest.level_m - before.level_m) <= _SAME_LEVEL * band_m:
            between = track.smooth_m[before.last : rest.first + 1]
            if float(np.abs(between - 0.5 * (rest.level_m + before.level_m)).max()) <= 1.5 * band_m:
                rows = (before.last - before.first + 1, rest.last - rest.first + 1)
                level_m = (before.level_m * rows[0] + rest.level_m * rows[1]) / sum(rows)
                joined[-1] = Rest(before.first, rest.last, level_m, min(before.error_m, rest.error_m))
                continue
        joined.append(rest)
    return joined


def _moves(track: _Track, rests: list[Rest]) -> list[Move]:
    """Return what lies between the rests, cut where the stem turned without one."""
    count = track.time_s.size
    firsts = [0, *(rest.last + 1 for rest in rests)]
    lasts = [*(rest.first - 1 for rest in rests), count - 1]
    moves: list[Move] = []
    for number, (begin, end) in enumerate(zip(firsts, lasts, strict=True)):
        before = rests[number - 1] if number > 0 else None
        numbers = (number - 1, number if number < len(rests) else -1)
        first = begin
        while first <= end:  # a run of rows ends at a gap, and a move with it
            last = min(end, int(track.run_last[first]))
            # a rest on the other side of a gap is not the one that the stem left or came to
            left = before if before is not None and first == begin and track.run_last[before.last] >= first else None
            after = rests[number] if last == end and number < len(rests) else None
            between = (left, after if after is not None and track.run_last[last] >= after.first else None)
            moves += _between(track, (first, last), between, numbers)
            first = last + 1
    return moves


def _between(
    track: _Track, rows: tuple[int, int], neighbours: tuple[Rest | None, Rest | None], numbers: tuple[int, int]
) -> list[Move]:
    """Moves in these rows, first and last, between the rests beside them (None where there is none)."""
    before, after = neighbours
    levels = [
        np.array([before.level_m] if before is not None else []),
        track.smooth_m[rows[0] : rows[1] + 1],
        np.array([after.level_m] if after is not None else []),
    ]
    way = np.concatenate(levels)
    if way.size < 2:
        return []
    offset = rows[0] - levels[0].size
    corners = extremes(way, 1.5 * track.band_m)
    moves = []
    for number in range(len(corners) - 1):
        distance_m = float(way[corners[number + 1]] - way[corners[number]])
        if abs(distance_m) <= track.band_m:
            continue
        direction = 1 if distance_m > 0.0 else -1
        first, last = max(rows[0], offset + corners[number]), min(rows[1], offset + corners[number + 1])
        left = before if number == 0 else None
        stops = after is not None and number == len(corners) - 2
        moves.append(
            Move(
                first,
                last,
                direction,
                numbers[0] if left is not None else -1,
                numbers[1] if stops else -1,
                math.nan if left is None else _began(track, left, last, direction),
                distance_m,
            )
        )
    return moves


def extremes(way: FloatArray, least: float) -> list[int]:
    """Rows of the first value of ``way``, shape (n,), any unit, of each turn by at least this much, and of the last."""
    turns: list[int] = _turns(way, least).tolist()
    return [0, *turns, way.size - 1]


@_kernel
def _turns(way: FloatArray, least: float) -> IntArray:
    """Rows of the turns by at least this much."""
    found = np.empty(way.size, np.int64)
    count = 0
    high = low = sense = 0
    for row in range(1, way.size):
        high = row if way[row] > way[high] else high
        low = row if way[row] < way[low] else low
        if sense >= 0 and way[high] - way[row] > least:
            if sense > 0 or way[high] - way[0] > least:
                found[count] = high
                count += 1
            sense, low = -1, row
        elif sense <= 0 and way[row] - way[low] > least:
            if sense < 0 or way[0] - way[low] > least:
                found[count] = low
                count += 1
            sense, high = 1, row
    return found[:count]


def _began(track: _Track, rest: Rest, last: int, direction: int) -> float:
    """When the stem left its rest, s: a power of time through its first way, drawn back to the rest."""
    time_s, half_m = track.time_s, 0.5 * track.band_m
    reach = min(last, rest.last + max(50, rest.last - rest.first))
    away_m = direction * (track.smooth_m[rest.first : reach + 1] - rest.level_m)
    still = np.flatnonzero(away_m <= half_m)
    row = min(rest.first + (int(still[-1]) if still.size else 0), time_s.size - 2)
    way_m = direction * (track.smooth_m[row : last + 1] - rest.level_m)
    early, middle, late = (_passing(time_s[row : last + 1], way_m, factor * half_m) for factor in (1.0, 2.0, 4.0))
    if math.isnan(late):
        return float(time_s[row])
    if late - early <= 1.0e-12:
        return 0.5 * float(time_s[row] + time_s[row + 1])
    # way ~ (t - began) ** p, so that the times of one, two and four ways grow by the same factor 2 ** (1/p)
    ratio = min(max((late - middle) / max(middle - early, 1.0e-12), 1.15), 2.5)
    power = min(max(math.log(2.0) / math.log(ratio), 1.0), 3.0)
    back_s = (middle - early) / float(2.0 ** (1.0 / power) - 1.0)
    return max(early - min(back_s, 3.0 * (late - early)), float(time_s[rest.first]))


def _passing(time_s: FloatArray, way_m: FloatArray, level_m: float) -> float:
    """When the way passes this level for the first time, s, between two rows; NaN if it does not."""
    beyond = np.flatnonzero(way_m > level_m)
    if beyond.size == 0:
        return math.nan
    at = int(beyond[0])
    if at == 0:
        return float(time_s[0])
    share = (level_m - way_m[at - 1]) / (way_m[at] - way_m[at - 1])
    return float(time_s[at - 1] + share * (time_s[at] - time_s[at - 1]))
