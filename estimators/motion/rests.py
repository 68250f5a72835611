"""Where the stem comes to rest and where it breaks away, to the row and, as far as noise lets, between rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.moving_rows import MovingRows, pieces_of
from estimators.samples import Samples

# Own choices, tried on the four published valves at 0-100 um and 1-50 ms.
_REST_SIGMAS: Final = 4.5  # a sample that far from the rest position has left it
_MOST_LEVEL_SAMPLES: Final = 200
# The stem creeps for sqrt(2 m DV / force rate) before it reaches DV, unseen below any noise: about a millisecond.
_CREEP_S: Final = 1.0e-3
_LATENESS_ERROR: Final = 1.5  # of the lateness that is taken out: the stem may start softly


@dataclass(frozen=True, slots=True)
class Breakaway:
    """The stem leaves its rest: ``row`` is the last at rest, the instant is ``time_s`` (uncertain by ``within_s``)."""

    row: int
    direction: int
    time_s: float
    within_s: float
    rest_m: float


@dataclass(frozen=True, slots=True)
class Span:
    """Unbroken motion in one direction, rows ``first`` to ``last``, and the breakaway that it began with."""

    first: int
    last: int
    direction: int
    left_rest: Breakaway | None


def find_spans(samples: Samples, moving: MovingRows) -> list[Span]:
    """Unbroken motion in one direction, its ends found to the row where it begins or ends at rest."""
    pieces, half_window = pieces_of(samples, moving.sense), moving.half_window
    spans = []
    for number, (first, last, direction) in enumerate(pieces):
        if direction == 0:
            continue
        before = _rest(samples, pieces[number - 1] if number else None, first, half_window)
        after = _rest(samples, pieces[number + 1] if number + 1 < len(pieces) else None, first, half_window)
        breakaway = (
            None
            if before is None
            else leave_of_rest(samples, before, first, last, direction=direction, half_window=half_window)
        )
        start = first if breakaway is None else breakaway.row + 1
        end = last if after is None else _end_of_motion(samples, after, first, last, half_window)
        if end - start >= 2 and (end - start + 1) > half_window:
            spans.append(Span(start, end, direction, breakaway))
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


def leave_of_rest(
    samples: Samples, rest: tuple[int, int], first: int, last: int, *, direction: int, half_window: int
) -> Breakaway:
    """Return where the stem leaves its rest: the first row beyond the noise, or earlier where its path says so.

    ``rest``: its first and last row; ``first`` and ``last`` those of the motion after it.
    """
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
