"""The force balance of a moving stem, averaged over windows of travel: what is left of a rough valve's motion.

Over a window of length T in motion with sense s the equation of motion says, without a difference of rows,

    mean F = k mean x + F_0 + s F_c + F_v (x_2 - x_1) / T + m (v_2 - v_1) / T,

and the last term is small: a window begins at rest or in steady motion. Local friction and noise are what is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.engine.segmentation import Move, Segmentation, moving_mean, segment
from estimators.motion.rests import Breakaway, leave_of_rest
from estimators.motion.windowed_slope import windowed_slope
from estimators.samples import BoolArray, FloatArray, IntArray, Samples
from valve.nameplate import Action
from valve.parameters import TravelStops

# Own choices, from rough valves (benchmark classic_rough).
_PARTS: Final = 50  # of the travel swept: about as long a window is, shorter than the roughness of a packing
_FEWEST_ROWS: Final = 3
_FEWEST_S: Final = 8.0e-3
_SETTLED: Final = 1.25  # of the ramp's speed: a slip is over there
_STARTED: Final = 0.75  # of the ramp's speed: a stem without a slip jump has come up to it
_SPEED_S: Final = 4.0e-3  # half a window of the speed
_RATE_S: Final = 0.04  # half a window of the force's rate, doubled as long as noise asks for it
_MOST_DOUBLED: Final = 3
_STEADY_RATE: Final = 0.15  # of the usual rate: what windows may be off the line of their neighbours
_LEAST_COAST_ROWS: Final = 8
_LEAST_COAST: Final = 8.0  # noises of way
_STILL_MOVES: Final = 0.2  # of the speed at the reversal
_FEWEST_REST_ROWS: Final = 8  # that tell a noise
SLIDE: Final = 0
SLIP: Final = 1
COAST: Final = 2
_NEAR_A_STOP: Final = 6.0  # noises


@dataclass(frozen=True, slots=True, eq=False)
class ForceWindows:
    """Windows of motion, arrays of shape (n,).

    ``force_n`` and ``position_m`` are means; ``sense`` is +-1, ``speed`` (x_2 - x_1) / T and ``rate``, N/s, that of the
    force, both in that sense. ``kind`` is SLIDE for steady motion, SLIP from a breakaway until the stem goes as its
    ramp, COAST after the force turned back. ``age_s`` is the time since the motion began, of the middle, and
    ``stroke`` numbers the strokes: motion in one direction between two reversals.
    """

    force_n: FloatArray
    position_m: FloatArray
    sense: FloatArray
    speed: FloatArray
    rate: FloatArray
    length_s: FloatArray
    time_s: FloatArray
    age_s: FloatArray
    kind: IntArray
    stroke: IntArray

    @property
    def is_slide(self) -> BoolArray:
        """Windows of steady motion."""
        return np.asarray(self.kind == SLIDE)

    @property
    def count(self) -> int:
        """Number of windows."""
        return int(self.force_n.size)


@dataclass(frozen=True, slots=True, eq=False)
class Leaving:
    """Breakaways, arrays of shape (n,): force and its rate at the instant, where it rested, sense, time, stroke.

    ``within_s`` is what the instant is open by.
    """

    force_n: FloatArray
    rate: FloatArray
    position_m: FloatArray
    sense: FloatArray
    time_s: FloatArray
    within_s: FloatArray
    stroke: IntArray

    @property
    def count(self) -> int:
        """Number of breakaways."""
        return int(self.force_n.size)


@dataclass(frozen=True, slots=True, eq=False)
class RoughMotion:
    """A recording's motion in windows, its breakaways, and where the stem stopped by itself within a stroke."""

    windows: ForceWindows
    leaving: Leaving
    stopping: Leaving
    swept_m: tuple[float, float]
    spring_n_per_m: float  # as it was taken for the ramp's speed; 0 without a spring
    directions: frozenset[int]
    hidden_m: float  # what noise hides: a stem that stays within it may rest


def rough_motion(
    samples: Samples, action: Action, stops: TravelStops | None, spring_n_per_m: float | None = None
) -> RoughMotion | None:
    """Return the motion of these samples; None where the stem did not move. ``spring_n_per_m`` where it is known."""
    if action is Action.DOUBLE:
        spring = 0.0
    else:
        spring = _spring_by_strokes(samples) if spring_n_per_m is None else spring_n_per_m
    if spring < 0.0:
        return None
    segmentation = segment(
        samples.time_s,
        samples.position_m,
        moving_mean(samples.force_n, 2 * (_steady_rate(samples)[0] // 2) + 1),
        samples.run_last,
        noise_m=samples.position_noise_m,
        spring_n_per_m=spring,
        is_commanded=samples.is_commanded,
    )
    if not segmentation.moves:
        return None
    return _Builder(samples, segmentation, spring, stops).build()


def _spring_by_strokes(samples: Samples) -> float:
    """A first spring rate, N/m: the slope of the middle between the force on the way up and on the way down.

    By the line of force over position through all rows: friction is above it as often as below.
    """
    position_m = samples.position_m - samples.position_m.mean()
    force_n = samples.force_n - samples.force_n.mean()
    square = float(position_m @ position_m)
    return float(position_m @ force_n) / square if square > 0.0 else -1.0


@dataclass(frozen=True, slots=True)
class _Motion:
    """What all windows of a move share: its sense, the number of its stroke, and when it began, s."""

    sense: int
    stroke: int
    began_s: float


def _steady_rate(samples: Samples) -> tuple[int, FloatArray]:
    """Half a window in rows that brings the noise of the force's rate down, and the rate with it, N/s, shape (n,)."""
    rows = max(2, round(_RATE_S / samples.period_s))
    rate = windowed_slope(samples, samples.force_n, rows)
    for _ in range(_MOST_DOUBLED):
        # second differences: of a wave the rate changes, too
        line = rate[: -4 * rows : rows] + rate[4 * rows :: rows]
        apart = np.abs(rate[2 * rows : -2 * rows : rows] - 0.5 * line)
        if apart.size == 0 or float(np.median(apart)) <= _STEADY_RATE * float(np.median(np.abs(rate))):
            break
        rows *= 2
        rate = windowed_slope(samples, samples.force_n, rows)
    return rows, rate


class _Builder:
    """Collects windows and breakaways move by move."""

    def __init__(self, samples: Samples, segmentation: Segmentation, spring: float, stops: TravelStops | None) -> None:
        self.samples, self.segmentation, self.spring = samples, segmentation, spring
        step_s = np.diff(samples.time_s)
        half = 0.5 * step_s
        self.force_sum = np.concatenate([[0.0], np.cumsum(half * (samples.force_n[1:] + samples.force_n[:-1]))])
        self.way_sum = np.concatenate([[0.0], np.cumsum(half * (samples.position_m[1:] + samples.position_m[:-1]))])
        self.speed = windowed_slope(samples, samples.position_m, max(1, round(_SPEED_S / samples.period_s)))
        self.rate_rows, self.rate = _steady_rate(samples)
        self.low_m = float(np.quantile(samples.position_m, 0.001))
        self.high_m = float(np.quantile(samples.position_m, 0.999))
        self.windows: list[tuple[float, ...]] = []
        self.leaving: list[tuple[float, ...]] = []
        self.stopping: list[tuple[float, ...]] = []
        self.near = _NEAR_A_STOP * samples.position_noise_m + 1.0e-3 * (self.high_m - self.low_m)
        self.stops = stops
        self.seen = replace(samples, position_noise_m=self._noise_at_rest_m())

    def _noise_at_rest_m(self) -> float:
        """All noise of the position, one standard deviation, m: colour and hum too, which differences do not show."""
        spreads = []
        for rest in self.segmentation.rests:
            margin = (rest.last - rest.first) // 4
            inner = self.samples.position_m[rest.first + margin : rest.last - margin // 2 + 1]
            if inner.size >= _FEWEST_REST_ROWS:
                spreads.append(float(np.std(inner)))
        noise_m = self.samples.position_noise_m
        return max(noise_m, min(float(np.median(spreads)), 3.0 * noise_m)) if spreads else noise_m

    def build(self) -> RoughMotion:
        stroke, before = -1, 0
        moves = self.segmentation.moves
        for number, move in enumerate(moves):
            if move.direction != before:
                stroke, before = stroke + 1, move.direction
            following = moves[number + 1] if number + 1 < len(moves) else None
            self._add(move, stroke, following)
        table = np.array(self.windows).T if self.windows else np.zeros((10, 0))
        force_n, position_m, sense, speed, rate, length_s, time_s, age_s, kind, strokes = table
        windows = ForceWindows(
            force_n=force_n,
            position_m=position_m,
            sense=sense,
            speed=speed,
            rate=rate,
            length_s=length_s,
            time_s=time_s,
            age_s=age_s,
            kind=kind.astype(np.int64),
            stroke=strokes.astype(np.int64),
        )
        return RoughMotion(
            windows,
            _leaving(self.leaving),
            _leaving(self.stopping),
            (self.low_m, self.high_m),
            self.spring,
            frozenset(self.segmentation.directions),
            self.segmentation.band_m,
        )

    def _add(self, move: Move, stroke: int, following: Move | None) -> None:
        samples, sense = self.samples, move.direction
        first, last = move.first, move.last
        begins_at_rest = move.rest >= 0 and math.isfinite(move.began_s)
        began_s = float(samples.time_s[first])
        if begins_at_rest:
            began = self._left(move)
            began_s = began.time_s
            self._add_leaving(move, began, stroke)
            first = int(np.searchsorted(samples.time_s, began_s, side="right"))
            first = min(max(first, self.segmentation.rests[move.rest].first + 1), last)
        if last - first < 1:
            return
        onward = np.flatnonzero(sense * self.rate[first : last + 1] > 0.0)
        turn = first + int(onward[-1]) if onward.size and self.spring > 0.0 else last
        goes_back = turn < last
        settled = self._settled(first, turn, sense) if begins_at_rest else first
        motion = _Motion(sense, stroke, began_s)
        if begins_at_rest and settled > first:
            self._window(motion, began_s, first, settled, SLIP)
        if settled >= turn and not goes_back and following is not None and following.direction == sense:
            self._add_stopping(move, stroke)
        self._slides(motion, settled, turn)
        if goes_back:
            self._coast(motion, turn, last)

    def _coast(self, motion: _Motion, turn: int, last: int) -> None:
        """The window after a reversal of the force, as long as the stem surely moves: at rest nothing shows F_c."""
        sense = motion.sense
        speed = sense * self.speed[turn : last + 1]
        slow = np.flatnonzero(speed < _STILL_MOVES * speed[0])
        end = turn + (int(slow[0]) - 1 if slow.size else speed.size - 1)
        way_m = sense * float(self.samples.position_m[max(end, turn)] - self.samples.position_m[turn])
        if end - turn >= _LEAST_COAST_ROWS and way_m > _LEAST_COAST * self.seen.position_noise_m:
            at_s = float(self.samples.time_s[turn])
            self._window(replace(motion, began_s=at_s), at_s, turn, end, COAST)

    def _settled(self, first: int, last: int, sense: int) -> int:
        """First row after a breakaway at which the stem goes as fast as its ramp asks for, or ``last``."""
        speed = sense * self.speed[first : last + 1]
        if self.spring > 0.0:
            ramp = np.abs(self.rate[first : last + 1]) / self.spring
        else:
            ramp = np.full(speed.size, float(np.median(speed)))
        fast = np.flatnonzero(speed > _SETTLED * ramp)
        width = max(1, round(_SPEED_S / self.samples.period_s))
        if fast.size and fast[0] <= 4 * width + 2:
            slow = np.flatnonzero(speed[fast[0] :] <= _SETTLED * ramp[fast[0] :])
            at = int(fast[0]) + int(slow[0]) + width if slow.size else speed.size - 1
        else:
            up = np.flatnonzero(speed >= _STARTED * ramp)
            at = int(up[0]) + width if up.size else speed.size - 1
        return min(last, first + max(at, 2))

    def _slides(self, motion: _Motion, first: int, last: int) -> None:
        """Windows of equal travel over steady motion."""
        samples, sense = self.samples, motion.sense
        length = (self.high_m - self.low_m) / _PARTS
        fewest = max(_FEWEST_ROWS, math.ceil(_FEWEST_S / samples.period_s))
        way_m = abs(float(samples.position_m[last] - samples.position_m[first]))
        parts = int(min(max(1.0, way_m / length), (last - first) // fewest))
        if parts < 1:
            return
        marks = np.linspace(samples.position_m[first], samples.position_m[last], parts + 1)[1:-1]
        way = np.maximum.accumulate(sense * samples.position_m[first : last + 1])
        edges = [first, *(first + np.searchsorted(way, sense * marks)).tolist(), last]
        begin = edges[0]
        for end in edges[1:]:
            if end - begin >= fewest:
                self._window(motion, float(samples.time_s[begin]), begin, end, SLIDE)
                begin = end

    def _window(self, motion: _Motion, began_s: float, first: int, last: int, kind: int) -> None:
        """The means from ``began_s`` (at or before row ``first``) to row ``last``."""
        samples, sense = self.samples, motion.sense
        lead_s = float(samples.time_s[first]) - began_s
        length_s = float(samples.time_s[last] - samples.time_s[first]) + lead_s
        if length_s <= 0.0 or self._on_stop(first, last):
            return
        begin_m, begin_n = float(samples.position_m[first]), float(samples.force_n[first])
        force_n = float(self.force_sum[last] - self.force_sum[first]) + lead_s * begin_n
        way = float(self.way_sum[last] - self.way_sum[first])
        at_rest_m = begin_m
        if kind == SLIP and lead_s > 0.0 and first > 0:
            at_rest_m = float(samples.position_m[first - 1])
            way += 0.5 * lead_s * (at_rest_m + begin_m)
        else:
            way += lead_s * begin_m
        speed = sense * (float(samples.position_m[last]) - at_rest_m) / length_s
        rate = sense * float(np.mean(self.rate[first : last + 1]))
        middle_s = began_s + 0.5 * length_s
        self.windows.append(
            (
                force_n / length_s,
                way / length_s,
                sense,
                speed,
                rate,
                length_s,
                middle_s,
                middle_s - motion.began_s,
                kind,
                motion.stroke,
            )
        )

    def _on_stop(self, first: int, last: int) -> bool:
        if self.stops is None:
            return False
        position_m = self.samples.position_m[first : last + 1]
        high, low = self.stops.high_m, self.stops.low_m
        return bool(position_m.max() > high - self.near or position_m.min() < low + self.near)

    def _left(self, move: Move) -> Breakaway:
        """Where the stem left its rest, by all rows and the noise of them."""
        rest = self.segmentation.rests[move.rest]
        margin = (rest.last - rest.first) // 4
        half_window = max(1, round(_SPEED_S / self.samples.period_s))
        return leave_of_rest(
            self.seen,
            (rest.first + margin, rest.last),
            move.first,
            move.last,
            direction=move.direction,
            half_window=half_window,
        )

    def _add_leaving(self, move: Move, began: Breakaway, stroke: int) -> None:
        rest = self.segmentation.rests[move.rest]
        if self._on_stop(rest.first, rest.last):
            return
        force_n, rate = self._force_at(began.time_s, began.row)
        self.leaving.append((force_n, rate, began.rest_m, move.direction, began.time_s, began.within_s, stroke))

    def _add_stopping(self, move: Move, stroke: int) -> None:
        if move.next_rest < 0:
            return
        samples, rest = self.samples, self.segmentation.rests[move.next_rest]
        if self._on_stop(rest.first, rest.last):
            return
        at_s = float(samples.time_s[rest.first])
        force_n, rate = self._force_at(at_s, rest.first)
        self.stopping.append((force_n, rate, rest.level_m, move.direction, at_s, samples.period_s, stroke))

    def _force_at(self, at_s: float, row: int) -> tuple[float, float]:
        """Force at an instant, N, and its rate, N/s, by the straight line about it."""
        samples = self.samples
        reach = self.rate_rows
        low = max(row - reach, int(samples.run_first[row]))
        high = min(row + reach, int(samples.run_last[row]))
        time_s, force_n = samples.time_s[low : high + 1] - at_s, samples.force_n[low : high + 1]
        middle_s = float(time_s.mean())
        spread = time_s - middle_s
        square = float(spread @ spread)
        slope = float(spread @ force_n) / square if square > 0.0 else 0.0
        return float(force_n.mean()) - slope * middle_s, slope


def _leaving(rows: list[tuple[float, ...]]) -> Leaving:
    table = np.array(rows).T if rows else np.zeros((7, 0))
    force_n, rate, position_m, sense, time_s, within_s, stroke = table
    return Leaving(force_n, rate, position_m, sense, time_s, within_s, stroke.astype(np.int64))
