"""The balance of forces as rows: blocks of driven motion and breakaways, with the coordinates that a law may depend on.

In a block the actuator's force is k x + F_0 + s (F_c + friction) - forces; at a breakaway F_s stands for F_c. A slip
from rest to rest is a block, too: over its way the forces do no work, so that their means along it are in balance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import Outcome
from estimators.engine.balance import ramps, settled_from_s
from estimators.engine.breakaways import breakaways
from estimators.engine.force_path import lagged
from estimators.engine.laws import Law, Where
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from estimators.engine.yielding import slides
from valve.nameplate import Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_ENOUGH: Final = 0.3  # of the blocks
_MOST_BREAKAWAYS: Final = 120
_SHORTEST_REST_S: Final = 0.03  # after less, on a slope of the friction, a stem hardly rests: it creeps on in steps
_FINE: Final = 0.008  # of the travel: a block of the slowest sweeps, a third of the length of what is rough
_COARSE: Final = 0.02  # of the travel at least: a block of all others
_FINE_BLOCKS: Final = 160
_COARSE_BLOCKS: Final = 140  # about, and two at least of each sweep
_SHORTEST_S: Final = 0.02
_AFTER_BREAKAWAY_S: Final = 0.08  # the mass and the sensor's filter show in what comes sooner
_SETTLED: Final = 8.0  # lags after a breakaway or a corner nothing is left of it
_LONGEST_SETTLED_S: Final = 4.0
_LATER_S: Final = 0.03  # than rows were read for, of which little is left in them
_FADED: Final = 6.0  # lags after a breakaway less is left of it than a packing as even as any varies by
_BEFORE_CORNER_S: Final = 0.03
_LATE_S: Final = 1.0e-3  # what is left of transients in quick sweeps, as a delay
_INSTANT: Final = 0.5  # of a row's period: how well a breakaway's instant is seen
_TURNING: Final = 0.12  # of a stroke
_HUNTING_S: Final = 0.15
_NOISE_S: Final = 0.02  # how long a gauge's noise stays alike, both ways
_NOISE_GROWS: Final = 3.0  # a coloured noise's size over its steps' from row to row
_ALONG_WAY: Final = (-0.4, -0.2, 0.0, 0.2, 0.4)  # of a slip's way: the middles of its fifths
_LEAST_RATE: Final = 1.0e-9  # N/s
_FIRST_SHARE: Final = 0.5  # of F_s: by how much the first breakaway after an unknown rest may differ


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Rows of the balance, arrays of shape (n,): ``is_slide`` where the stem moves, else it breaks away.

    ``variance_n2`` is what noise gives beside the friction's own variation. ``smooth_n`` is the force by a plain valve:
    a law that depended on the measured one would explain its noise by itself. Blocks come first.
    """

    time_s: FloatArray
    travel_m: FloatArray
    direction: FloatArray
    rate_n_per_s: FloatArray
    force_n: FloatArray
    smooth_n: FloatArray
    rested_s: FloatArray
    before: FloatArray  # direction of the move before the rest, 0 where there is none
    is_slide: BoolArray
    variance_n2: FloatArray
    duration_s: FloatArray
    speed_m_per_s: FloatArray  # by the force's rate where a spring holds the stem, of the stem where none does
    way_m: FloatArray  # that a row is a mean over, 0 where it is of one place
    has_spring: bool

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.time_s.size)

    @property
    def has_breakaways(self) -> bool:
        """Whether some rows are breakaways."""
        return not bool(self.is_slide.all())

    def rows(self, chosen: BoolArray) -> Observations:
        """Return the ``chosen`` rows, shape (n,), alone."""
        return Observations(
            self.time_s[chosen],
            self.travel_m[chosen],
            self.direction[chosen],
            self.rate_n_per_s[chosen],
            self.force_n[chosen],
            self.smooth_n[chosen],
            self.rested_s[chosen],
            self.before[chosen],
            self.is_slide[chosen],
            self.variance_n2[chosen],
            self.duration_s[chosen],
            self.speed_m_per_s[chosen],
            self.way_m[chosen],
            self.has_spring,
        )

    @property
    def _usually_rested_s(self) -> FloatArray:
        """How long the rests would have been with the usual breakaway, s.

        On a ramp a stem that breaks away harder has rested longer for that.
        """
        later_s = self.direction * (self.force_n - self.smooth_n) / np.maximum(np.abs(self.rate_n_per_s), _LEAST_RATE)
        return np.maximum(self.rested_s - np.where(self.is_slide, 0.0, later_s), 0.0)

    def above(self, speed_m_per_s: float) -> Observations:
        """Return the rows without motion slower than this, all if that leaves too few.

        A stem that creeps at its limit velocity rests now and then, unseen: its friction lies between F_c and F_s.
        """
        quick = np.abs(self.speed_m_per_s) > speed_m_per_s
        enough = int((quick & self.is_slide).sum()) > _ENOUGH * int(self.is_slide.sum())
        both = np.unique(self.direction[quick & self.is_slide]).size == 2
        return self.rows(quick | ~self.is_slide) if enough and both else self

    def beyond(self, reading: Reading, way_m: float) -> Observations:
        """Return the motion of a stem on bristles that slides, further than this from a turn, and no breakaway."""
        times_s, places_m, lengths_s, speed = self.time_s, self.travel_m, self.duration_s, self.speed_m_per_s
        slid = slides(reading, way_m, time_s=times_s, travel_m=places_m, duration_s=lengths_s, speed=speed)
        return self.rows(self.is_slide & slid)

    def added_n(self, law: Law, values: FloatArray, share: float) -> FloatArray:
        """What a law adds to the actuator's force of each row, N, shape (n,); ``share`` is F_s over F_c."""
        total = np.empty(self.count)
        total[self.is_slide] = self._added_n(law, values, share, self.is_slide, 0.0)
        total[~self.is_slide] = self._added_n(law, values, share, ~self.is_slide, 0.0)
        if bool((slips := self.way_m > 0.0).any()):
            along = [self._added_n(law, values, share, slips, place) for place in _ALONG_WAY]
            total[slips] = np.mean(along, axis=0)
        return total

    def _added_n(self, law: Law, values: FloatArray, share: float, part: BoolArray, place: float) -> FloatArray:
        """What a law adds to these rows, all motion or all breakaways, at a place along their way from -1/2 to 1/2."""
        rate, sign, speed = self.rate_n_per_s[part], self.direction[part], self.speed_m_per_s[part]
        where = Where(
            self.time_s[part], self.travel_m[part] + place * self.way_m[part], speed, self.smooth_n[part], rate, sign,
            self._usually_rested_s[part], self.before[part],
        )  # fmt: skip
        slide = bool(self.is_slide[part].all())
        friction_n = law.friction_n(values, where) if slide else law.breakaway_n(values, where, share)
        return sign * friction_n - law.force_n(values, where)


def as_measured(recording: Recording, nameplate: Nameplate) -> Reading | Outcome:
    """Return what a recording shows, its force as late as it was measured, be that the gauge's or the I/P's.

    The balance is of the measured force, and a stem that is simulated under it must be driven by the same.
    """
    reading = read(measured_rows(recording).recording, nameplate)
    if isinstance(reading, Outcome) or reading.path.by_converter is None:
        return reading
    return replace(reading, path=reading.path.by_converter)


def is_settled(lag: Known, late_s: float) -> bool:
    """Whether rows that were read for this lag leave out the transients of a stem that follows so much later, s."""
    return settled_s(late_s) <= settled_s(lag.value + _LATER_S) and settled_s(lag.value) >= _FADED * late_s


def settled_s(late_s: float) -> float:
    """How long after a breakaway or a corner a stem that follows so late is still in transients, s."""
    return min(_SETTLED * late_s + _AFTER_BREAKAWAY_S, _LONGEST_SETTLED_S)


def observations(reading: Reading, lag: Known, *, slips: bool = False) -> Observations:
    """Return the rows of a reading; ``lag`` is how late the stem follows the force, s.

    ``slips``: with those of moves from rest to rest that have no block of driven motion.
    """
    table = _blocks(reading, lag)
    if slips:
        table = np.hstack([table, _slips(reading, table[0])])
        table = table[:, np.argsort(table[0], kind="stable")]
    time_s, travel_m, rate, force_n, direction, count, duration_s, speed, way_m, rested_s, after, late_n2 = table
    found, spring = breakaways(reading), reading.spring_n_per_m
    has_spring = spring > 0.0
    first_s = [reading.time_s[reading.segmentation.rests[one.rest].first] for one in reading.segmentation.breakaways]
    began_s = np.array([one.began_s for one in reading.segmentation.breakaways])
    # the rest before each breakaway that was found, and what led to it
    at = np.searchsorted(began_s, found.time_s - 1.0e-9)
    rests_s = found.time_s - np.array(first_s)[at]
    arrived = {one.next_rest: one.direction for one in reading.segmentation.moves}
    before = np.array([arrived.get(one.rest, 0) for one in reading.segmentation.breakaways], dtype=np.float64)[at]
    rested = np.flatnonzero(rests_s >= _SHORTEST_REST_S)
    kept = rested[np.unique(np.linspace(0, rested.size - 1, min(rested.size, _MOST_BREAKAWAYS)).astype(np.int64))]
    noise_n2 = (spring * reading.noise_m) ** 2
    beside_n, beside_n2 = _beside(reading, time_s, duration_s)
    of_breakaways = np.full(kept.size, noise_n2 + reading.path.noise_n**2)
    rate_of = np.abs(found.rate_n_per_s[kept])
    of_breakaways += (_INSTANT * reading.samples.period_s * rate_of) ** 2
    # a stem that starts slowly is seen to move only when it has gone as far as the noise: rate t^2 / (2 k lag)
    of_breakaways += 2.0 * lag.value * spring * reading.noise_m * rate_of
    if kept.size and abs(float(found.time_s[0]) - float(began_s[0])) < 1.0e-9:
        of_breakaways[0] += (_FIRST_SHARE * abs(float(found.direction[0] * found.force_n[0]))) ** 2
    many = np.concatenate
    places_m, ways = many([travel_m, found.travel_m[kept]]), many([direction, found.direction[kept]])
    forces_n, slide = many([force_n + beside_n, found.force_n[kept]]), np.arange(ways.size) < time_s.size
    return Observations(
        many([time_s, found.time_s[kept]]),
        places_m,
        ways,
        many([rate, found.rate_n_per_s[kept]]),
        forces_n,
        _smooth(places_m, ways, slide, forces_n),
        many([rested_s, rests_s[kept]]),
        many([after, before[kept]]),
        slide,
        many([noise_n2 / count + reading.path.noise_n**2 + beside_n2 + late_n2, of_breakaways]),
        many([duration_s, np.zeros(kept.size)]),
        many([rate / spring if has_spring else speed, np.zeros(kept.size)]),
        many([way_m, np.zeros(kept.size)]),
        has_spring,
    )


def _smooth(travel_m: FloatArray, direction: FloatArray, slide: BoolArray, force_n: FloatArray) -> FloatArray:
    """The force by least squares on place and direction, for motion and breakaway each, N, shape (n,)."""
    design = np.column_stack([travel_m, np.ones(travel_m.size), direction * slide, direction * ~slide])
    return np.asarray(design @ np.linalg.lstsq(design, force_n, rcond=None)[0])


def _spans(reading: Reading, settled_s: float) -> list[tuple[int, int, int]]:
    """First and last row of each part of the moves in which the stem is driven, and its direction, slowest first."""
    time_s, force_n, corners_s = reading.time_s, reading.path.force_n, reading.path.corners_s
    has_spring = reading.spring_n_per_m > 0.0
    spans = []
    for move in reading.segmentation.moves:
        began_s = move.began_s if move.rest >= 0 else float(time_s[move.first])
        begin_s = settled_from_s(reading, move, settled_s)
        # without a spring the force does not turn with the stem
        inside = corners_s[(corners_s > begin_s) & (corners_s < time_s[move.last])] if has_spring else corners_s[:0]
        for left_s, right_s in pairwise([begin_s, *inside.tolist(), float(time_s[move.last])]):
            first = int(np.searchsorted(time_s, left_s + (0.0 if left_s == begin_s else settled_s)))
            # a drive without a spring speeds up and slows down where it turns
            margin_s = 0.0 if has_spring else _TURNING * (right_s - left_s)
            first = max(first, int(np.searchsorted(time_s, left_s + margin_s)))
            last = int(np.searchsorted(time_s, right_s - max(_BEFORE_CORNER_S, margin_s))) - 1
            if last - first < 2:
                continue
            if not has_spring:
                spans.append((first, last, move.direction))
            elif move.direction * (force_n[last] - force_n[first]) > 0.0:
                driven_s = began_s if left_s == begin_s else left_s
                spans += [(*part, move.direction) for part in ramps(reading, first, last, settled_s, driven_s)]

    def speed(span: tuple[int, int, int]) -> float:
        way_m = abs(float(reading.position_m[span[1]] - reading.position_m[span[0]]))
        return float(np.round(np.log(max(way_m / float(time_s[span[1]] - time_s[span[0]]), 1.0e-12)), 1))

    return sorted(spans, key=speed)


def _blocks(reading: Reading, lag: Known) -> FloatArray:
    """Means over pieces of driven motion, shape (12, n).

    Time, travel, rate, force, direction, rows, duration, speed, three that are 0, and what transients leave, N^2.
    """
    time_s, position_m, force_n = reading.time_s, reading.position_m, reading.path.force_n
    period_s = float(np.median(np.diff(time_s)))
    followed_n = force_n
    if lag.value > _HUNTING_S:  # what an I/P does by itself drives so late a stem as far as it follows
        followed_n = lagged(time_s, force_n, lag.value, np.diff(reading.samples.run_first, prepend=0) > 0)
    columns: list[tuple[float, ...]] = []
    spans = _spans(reading, settled_s(lag.value))
    ways_m = np.array([abs(float(position_m[last] - position_m[first])) for first, last, _ in spans])
    fine = np.cumsum(ways_m) - ways_m < _FINE_BLOCKS * _FINE * reading.travel_m
    coarse_m = max(_COARSE * reading.travel_m, float(ways_m[~fine].sum()) / _COARSE_BLOCKS)
    for (first, last, direction), way, is_fine in zip(spans, ways_m, fine, strict=True):
        way_m = float(way)
        longest_m = _FINE * reading.travel_m if is_fine else min(coarse_m, 0.5 * way_m)
        longest_s = max(_SHORTEST_S, float(time_s[last] - time_s[first]) * longest_m / max(way_m, longest_m))
        count = max(1, (last - first + 1) // max(1, round(longest_s / period_s)))
        for rows in np.array_split(np.arange(first, last + 1), count):
            reach = slice(max(first, int(rows[0]) - 2), min(last, int(rows[-1]) + 2) + 1)
            away_s = time_s[reach] - time_s[reach].mean()
            rate = float(away_s @ followed_n[reach]) / float(away_s @ away_s)
            columns.append(
                (
                    float(time_s[rows].mean()), float(position_m[rows].mean()), rate, float(force_n[rows].mean()),
                    float(direction), float(rows.size), float(time_s[rows[-1]] - time_s[rows[0]]) + period_s,
                    float(away_s @ position_m[reach]) / float(away_s @ away_s), 0.0, 0.0, 0.0, (_LATE_S * rate) ** 2,
                )
            )  # fmt: skip
    table = np.array(columns).reshape(-1, 12).T
    return np.ascontiguousarray(table[:, np.argsort(table[0], kind="stable")])


def _slips(reading: Reading, driven_s: FloatArray) -> FloatArray:
    """Means over the way of each move from rest to rest without a block, in the same order, shape (12, n).

    ``driven_s`` are the blocks' times. The rate is that of a force which would drive a stem as quickly as a slip does.
    Instead of zeros: the way, how long the rest before it was, and the direction of the move before that.
    """
    time_s, force_n, spring = reading.time_s, reading.path.force_n, reading.spring_n_per_m
    rests, period_s = reading.segmentation.rests, reading.samples.period_s
    arrived = {one.next_rest: one.direction for one in reading.segmentation.moves}
    slips = [one for one in reading.segmentation.breakaways if one.next_rest >= 0]
    took_s = max(float(np.median([time_s[one.last] - time_s[one.first] for one in slips] or [0.0])), period_s)
    columns: list[tuple[float, ...]] = []
    for move in slips:
        before, after = rests[move.rest], rests[move.next_rest]
        way_m, (begin_s, end_s) = abs(after.level_m - before.level_m), time_s[[before.last, after.first]].tolist()
        if bool(np.any((driven_s >= begin_s) & (driven_s <= end_s))) or way_m <= reading.segmentation.band_m:
            continue
        rows = slice(before.last, after.first + 1)
        gone_m = np.maximum(move.direction * np.diff(reading.position_m[rows]), 0.0)  # noise goes back, too
        if not gone_m.any():
            continue
        along_n = 0.5 * (force_n[rows][1:] + force_n[rows][:-1])
        rate = (force_n[after.first] - force_n[before.last]) / max(end_s - begin_s, period_s)
        speed, rested_s = move.direction * way_m / took_s, float(time_s[before.last] - time_s[before.first])
        columns.append(
            (
                0.5 * (begin_s + end_s), 0.5 * (before.level_m + after.level_m), speed * spring,
                float(along_n @ gone_m / gone_m.sum()), float(move.direction), float(after.first - before.last),
                end_s - begin_s, speed, way_m, rested_s, float(arrived.get(move.rest, 0)),
                (_INSTANT * period_s * rate) ** 2,
            )
        )  # fmt: skip
    return np.array(columns).reshape(-1, 12).T


def _beside(reading: Reading, time_s: FloatArray, duration_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the gauge saw beside the force's lines, N, averaged over blocks, and its variance: an I/P that hunts.

    Averaged over ``_HUNTING_S`` at least, which is quicker than a hunting I/P and slower than a gauge's noise.
    """
    left_n, times_s = reading.samples.force_n - reading.path.force_n, reading.time_s
    if reading.spring_n_per_m <= 0.0 or not bool(np.any(left_n)):
        return np.zeros(time_s.size), np.zeros(time_s.size)
    half_s = 0.5 * np.maximum(duration_s, _HUNTING_S)
    first, last = np.searchsorted(times_s, time_s - half_s), np.searchsorted(times_s, time_s + half_s)
    last = np.minimum(np.maximum(last, first + 1), left_n.size)
    sums = np.concatenate([[0.0], np.cumsum(left_n)])
    mean_n = (sums[last] - sums[first]) / (last - first)
    noise_n = float(np.std(np.diff(left_n))) if left_n.size > 2 else 0.0
    rms_n = min(noise_n * _NOISE_GROWS, float(np.std(left_n)))
    return mean_n, rms_n**2 * np.minimum(1.0, _NOISE_S / (2.0 * half_s))
