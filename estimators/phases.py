"""What the stem did: where it was at rest, where it broke away, where it moved, and where it ran into a stop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import Outcome
from estimators.samples import BoolArray, FloatArray, IntArray, Samples
from estimators.windowed_slope import windowed_slope, windowed_slope_noise

# Own choices, tried on the four published valves at 0-100 um and 1-50 ms.
_COARSE_WINDOWS: Final = 200  # parts of the recording whose mean positions give the path travelled
_NOISE_OF_PATH_SPEED: Final = 0.08  # the windowed velocity's noise as a share of the mean speed
_MOVING_SIGMAS: Final = 5.0
_MOVING_SHARE: Final = 0.1  # of the median moving speed
_SLOW_SHARE: Final = 0.2  # of the limit of motion: what drifts faster is not at rest
_REST_SIGMAS: Final = 4.5  # a sample that far from the rest position has left it
# The stem creeps for sqrt(2 m DV / force rate) before it reaches DV, unseen below any noise: about a millisecond.
_CREEP_S: Final = 1.0e-3
_LATENESS_ERROR: Final = 1.5  # of the lateness that is taken out: the stem may start softly
_CORNER_WINDOW_S: Final = 0.05
_MOST_LEVEL_SAMPLES: Final = 200


class After(StrEnum):
    """What a stretch of motion began with."""

    BREAKAWAY = "breakaway"
    CORNER = "corner"  # the force's slope changed while the stem moved
    UNKNOWN = "unknown"  # the recording, or one of its runs, begins in motion


@dataclass(frozen=True, slots=True)
class Stretch:
    """Motion in one direction (+1, -1) on one line of the force: rows ``first`` to ``last``, both in motion."""

    first: int
    last: int
    direction: int
    after: After
    driven: bool  # the force still rises in the direction of motion (or holds); False: it coasts after a reversal

    @property
    def rows(self) -> slice:
        """The rows of the stretch."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True, slots=True)
class Breakaway:
    """The stem leaves its rest: ``row`` is the last at rest, the instant is ``time_s`` (uncertain by ``within_s``)."""

    row: int
    direction: int
    time_s: float
    within_s: float
    rest_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """The phases of one recording; ``velocity`` is the windowed one, shape (n,), for choosing and not for fitting."""

    velocity: FloatArray
    half_window: int
    moving_speed: float
    stretches: tuple[Stretch, ...]
    breakaways: tuple[Breakaway, ...]
    corners: IntArray
    force_rate: FloatArray

    @property
    def directions(self) -> set[int]:
        """Directions in which the stem moved."""
        return {stretch.direction for stretch in self.stretches}

    def differenced_rows(self, count: int) -> BoolArray:
        """Rows, shape (n,), whose backward differences reach over driven motion alone: no rest, corner or gap in them.

        What coasts after a reversal is left out: there the bias of differences is another one.
        """
        chosen = np.zeros(count, dtype=np.bool_)
        for stretch in self.stretches:
            if stretch.driven:
                chosen[self.first_differenced_row(stretch) : stretch.last + 1] = True
        return chosen

    def first_differenced_row(self, stretch: Stretch) -> int:
        """First row whose differences are of this motion: the third, one later after a breakaway.

        There the stem accelerates below DV at first, for sqrt(2 m DV / force rate): about a millisecond.
        """
        return stretch.first + (3 if stretch.after is After.BREAKAWAY else 2)


def find_phases(samples: Samples) -> Phases | Outcome:
    """Return the phases, or the outcome where the stem never moved."""
    speed = _path_speed(samples)
    if speed is None:
        return Outcome.NEVER_MOVED
    half_window = _half_window(samples, speed)
    velocity = windowed_slope(samples, samples.position_m, half_window)
    noise = windowed_slope_noise(samples.position_noise_m, half_window, samples.period_s)
    pace = np.abs(velocity)
    lively = pace[pace > max(_MOVING_SIGMAS * noise, 0.2 * speed)]
    if lively.size < 3:
        return Outcome.NEVER_MOVED
    moving_speed = float(np.median(lively))
    limit = max(_MOVING_SIGMAS * noise, _MOVING_SHARE * moving_speed)
    sense = np.where(pace > limit, np.sign(velocity), 0.0).astype(np.int8)
    sense = _without_slow_motion(samples, sense, pace, limit)
    force_window = max(half_window, 2, round(_CORNER_WINDOW_S / samples.period_s))
    force_rate = windowed_slope(samples, samples.force_n, force_window)
    corners = _corners(samples, force_rate, force_window)
    spans = _spans(samples, sense, half_window)
    breakaways: list[Breakaway] = []
    stretches: list[Stretch] = []
    for span in spans:
        if span.left_rest is not None:
            breakaways.append(span.left_rest)
        stretches += _split(span, corners, force_rate)
    if not stretches:
        return Outcome.NEVER_MOVED
    return Phases(velocity, half_window, moving_speed, tuple(stretches), tuple(breakaways), corners, force_rate)


def _path_speed(samples: Samples) -> float | None:
    """Mean speed along the path, m/s, from mean positions of coarse windows; None where it is all noise."""
    width = max(1, samples.count // _COARSE_WINDOWS)
    windows = samples.count // width
    means = samples.position_m[: windows * width].reshape(windows, width).mean(axis=1)
    noise = samples.position_noise_m / math.sqrt(width)
    if float(np.ptp(means)) <= 8.0 * noise + 1.0e-9 * float(np.abs(means).max()):
        return None
    steps = np.abs(np.diff(means))
    path_m = float(steps[steps > 4.0 * noise].sum())
    duration_s = float(samples.time_s[-1] - samples.time_s[0])
    return path_m / duration_s if path_m > 0.0 else None


def _half_window(samples: Samples, speed: float) -> int:
    """Rows on each side that bring the windowed velocity's noise to a small share of the mean speed."""
    wanted = samples.position_noise_m * math.sqrt(2.0) / (_NOISE_OF_PATH_SPEED * speed * samples.period_s)
    most = max(1, samples.count // 100)
    return int(min(most, max(1.0, math.ceil(min(wanted, 1.0e9) ** (2.0 / 3.0)))))


def _corners(samples: Samples, force_rate: FloatArray, window: int) -> IntArray:
    """Rows nearest to where the force's slope changes its sign, starts or ends."""
    typical = float(np.median(np.abs(force_rate)))
    if typical == 0.0:
        typical = float(np.abs(force_rate).max())
    dead = max(0.2 * typical, 4.0 * windowed_slope_noise(samples.force_noise_n, window, samples.period_s))
    sense = np.where(np.abs(force_rate) > dead, np.sign(force_rate), 0.0)
    flips = np.flatnonzero((sense[1:] != sense[:-1]) & (samples.run_first[1:] == samples.run_first[:-1]))
    # two flips within a window (+, 0, -) are one corner
    groups = np.split(flips, np.flatnonzero(np.diff(flips) > 2 * window) + 1) if flips.size else []
    found = []
    for group in groups:
        low = max(int(group[0]) - window, int(samples.run_first[group[0]]) + 1)
        high = min(int(group[-1]) + window + 1, int(samples.run_last[group[0]]) - 1)
        if high <= low:
            continue
        force_n = samples.force_n
        rows = np.arange(low, high + 1)
        if sense[group[0]] * sense[group[-1] + 1] < 0:
            found.append(int(rows[np.argmax(sense[group[0]] * force_n[rows])]))
        else:
            bend = np.abs(force_n[rows + 1] - 2.0 * force_n[rows] + force_n[rows - 1])
            found.append(int(rows[np.argmax(bend)]))
    return np.array(found, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class _Span:
    first: int
    last: int
    direction: int
    left_rest: Breakaway | None


def _pieces(samples: Samples, sense: npt.NDArray[np.int8]) -> list[tuple[int, int, int]]:
    """First row, last row and sense of each stretch of rows without a change of sense or a gap."""
    edges = np.flatnonzero((sense[1:] != sense[:-1]) | (samples.run_first[1:] != samples.run_first[:-1])) + 1
    bounds = np.concatenate([[0], edges, [sense.size]])
    return [(first, end - 1, int(sense[first])) for first, end in pairwise(bounds.tolist())]


def _without_slow_motion(
    samples: Samples, sense: npt.NDArray[np.int8], pace: FloatArray, limit: float
) -> npt.NDArray[np.int8]:
    """The sense, with rests filled in that are none: between motions of one direction, the stem goes on slowly."""
    pieces = _pieces(samples, sense)
    filled = sense.copy()
    for before, rest, after in zip(pieces, pieces[1:], pieces[2:], strict=False):
        if rest[2] != 0 or before[2] != after[2]:
            continue
        first, last = rest[0], rest[1]
        if not samples.run_first[before[1]] == samples.run_first[first] == samples.run_first[after[0]]:
            continue
        half = (last - first + 1) // 2
        if half < 1 or float(pace[first : last + 1].min()) > limit / 3.0:
            filled[first : last + 1] = before[2]
            continue
        early = float(np.median(samples.position_m[first : first + half]))
        late = float(np.median(samples.position_m[last + 1 - half : last + 1]))
        way_m = before[2] * (late - early)
        run_s = float(samples.time_s[last] - samples.time_s[first]) / 2.0
        noise_m = 1.25 * math.sqrt(2.0 / half) * samples.position_noise_m
        if way_m > 3.0 * noise_m and way_m > _SLOW_SHARE * limit * run_s:
            filled[first : last + 1] = before[2]
    return filled


def _spans(samples: Samples, sense: npt.NDArray[np.int8], half_window: int) -> list[_Span]:
    """Unbroken motion in one direction, its ends found to the row where it begins or ends at rest."""
    pieces = _pieces(samples, sense)
    spans = []
    for number, (first, last, direction) in enumerate(pieces):
        if direction == 0:
            continue
        before = _rest(samples, pieces[number - 1] if number else None, first, half_window)
        after = _rest(samples, pieces[number + 1] if number + 1 < len(pieces) else None, first, half_window)
        breakaway = (
            None
            if before is None
            else _breakaway(samples, before, first, last, direction=direction, half_window=half_window)
        )
        start = first if breakaway is None else breakaway.row + 1
        end = last if after is None else _end_of_motion(samples, after, first, last, half_window)
        if end - start >= 2 and (end - start + 1) > half_window:
            spans.append(_Span(start, end, direction, breakaway))
    return spans


def _rest(samples: Samples, piece: tuple[int, int, int] | None, row: int, half_window: int) -> tuple[int, int] | None:
    """First and last row that are surely at rest in a neighbouring piece, or None."""
    if piece is None or piece[2] != 0 or samples.run_first[piece[0]] != samples.run_first[row]:
        return None
    first, last, _ = piece
    # a window that reaches into the motion calls its row moving, so what is left is at rest; noise may say otherwise
    margin = min(half_window // 2, (last - first) // 4)
    return first + margin, last - margin


def _tolerance(samples: Samples) -> float:
    return _REST_SIGMAS * samples.position_noise_m + 1.0e-9 * float(np.ptp(samples.position_m))


def _breakaway(
    samples: Samples, rest: tuple[int, int], first: int, last: int, *, direction: int, half_window: int
) -> Breakaway:
    """Where the stem leaves its rest: the first row beyond the noise, or earlier where its path says so."""
    rest_first, rest_last = rest
    begin = max(rest_first, rest_last - _MOST_LEVEL_SAMPLES)
    level_m = float(np.median(samples.position_m[begin : rest_last + 1]))
    reach = min(last, first + 4 * half_window + 8)
    away_m = direction * (samples.position_m[begin : reach + 1] - level_m)
    # the last row that is not away, before motion for good
    still = np.flatnonzero(away_m <= _tolerance(samples))
    row = min(begin + (int(still[-1]) if still.size else 0), last - 1)
    time_s = samples.time_s
    seen_s = 0.5 * float(time_s[row] + time_s[row + 1])
    half_step_s = 0.5 * float(time_s[row + 1] - time_s[row])
    late_s = _lateness(samples, row + 1, last, direction, level_m)
    at_s = max(seen_s - late_s, float(time_s[rest_first]))
    row = int(np.searchsorted(time_s, at_s, side="right")) - 1
    creep_s = _CREEP_S if samples.position_noise_m > 0.0 else 0.0
    step_error_s = math.hypot(half_step_s / math.sqrt(3.0), creep_s)
    return Breakaway(row, direction, at_s, max(step_error_s, _LATENESS_ERROR * abs(late_s)), level_m)


def _lateness(samples: Samples, row: int, last: int, direction: int, level_m: float) -> float:
    """How long before the middle of the step to ``row``, the first beyond the noise, the stem crept away, s.

    A straight line through the rows in which it goes on by twice the noise, drawn back to its rest. 0 for a jump:
    that leaves the noise at once.
    """
    noise_m = _REST_SIGMAS * samples.position_noise_m
    reach = slice(row, min(last, row + 1000) + 1)
    time_s = samples.time_s[reach]
    way_m = direction * (samples.position_m[reach] - level_m)
    if time_s.size < 3 or noise_m == 0.0:
        return 0.0
    if float(way_m[0]) > 2.0 * noise_m:
        # seen at once and steady from the start, or a jump
        early, late = float(way_m[1] - way_m[0]), float(way_m[2] - way_m[1])
        steady = abs(late - early) < 0.3 * early + noise_m and float(way_m[0]) < 1.2 * early + noise_m
        if not steady:
            return 0.0
        end = 3
    else:
        gone_on = np.flatnonzero(way_m >= way_m[0] + 2.0 * noise_m)
        if gone_on.size == 0:
            return 0.0
        end = max(3, int(gone_on[0]) + 1)
    middle_s, middle_m = float(time_s[:end].mean()), float(way_m[:end].mean())
    spread_s = time_s[:end] - middle_s
    slope = float(spread_s @ way_m[:end]) / float(spread_s @ spread_s)
    if slope <= 0.0:
        return 0.0
    half_step_s = 0.5 * float(samples.time_s[row] - samples.time_s[row - 1])
    late_s = float(time_s[0]) - half_step_s - (middle_s - middle_m / slope)
    return min(max(-half_step_s, late_s), float(time_s[end - 1] - time_s[0]))


def _end_of_motion(samples: Samples, rest: tuple[int, int], first: int, last: int, half_window: int) -> int:
    """Last row of the motion that is still away from the rest that follows."""
    rest_first, rest_last = rest
    # the later part: the stem may still creep into its rest
    level_m = float(np.median(samples.position_m[(rest_first + rest_last) // 2 : rest_last + 1][:_MOST_LEVEL_SAMPLES]))
    begin = max(first, last - 4 * half_window - 8)
    end = min(rest_last, rest_first + _MOST_LEVEL_SAMPLES)
    away = np.abs(samples.position_m[begin : end + 1] - level_m) > _tolerance(samples)
    still = np.flatnonzero(~away)
    # the first that is not away: at the end of the rest the next motion already creeps
    return max(begin, begin + int(still[0]) - 1) if still.size else last


def _split(span: _Span, corners: IntArray, force_rate: FloatArray) -> list[Stretch]:
    """Cut a span at the corners of the force."""
    inside = corners[(corners > span.first) & (corners < span.last)]
    begin = After.UNKNOWN if span.left_rest is None else After.BREAKAWAY
    # the corner lies within one row of its row
    firsts = [span.first, *(int(corner) + 1 for corner in inside)]
    lasts = [*(int(corner) - 1 for corner in inside), span.last]
    stretches = []
    opposing = 0.05 * float(np.abs(force_rate).max())  # a force that holds does not oppose
    for number, (first, last) in enumerate(zip(firsts, lasts, strict=True)):
        if last - first < 2:
            continue
        middle = (first + last) // 2
        driven = bool(force_rate[middle] * span.direction > -opposing)
        stretches.append(Stretch(first, last, span.direction, begin if number == 0 else After.CORNER, driven))
    return stretches
