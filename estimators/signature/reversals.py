"""Reversals: how far the input turns back before the stem answers in the new direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.phases import Phases, Stretch
from estimators.motion.rests import Breakaway
from estimators.motion.static_friction import force_at
from estimators.samples import FloatArray, Samples
from estimators.scatter import Measured
from valve.parameters import TravelStops

_LINE_ROWS: Final = 60  # own choice: rows on each side of a corner for the line through them
_STRAIGHT: Final = 3.0  # noises; what is off the line by more is a curve
_FEWEST_ROWS: Final = 3
_RATES_APART: Final = 1.2  # as for the passes
_CLEAR_SIGMAS: Final = 9.0
_SOFT_ROWS: Final = 2000
_LARGEST_LEAP: Final = 0.05  # of the range: an input that leaps by more at the breakaway does not show where it was


@dataclass(frozen=True, slots=True)
class Reversal:
    """One reversal: the range of the force from its turn to the breakaway, N, the breakaway's timing error, N."""

    range_n: float
    timing_n: float
    rate_n_per_s: float  # of the force, before or after the turn, whichever was faster


def reversals(samples: Samples, phases: Phases, stops: TravelStops | None) -> list[Reversal]:
    """Return the reversals at the slowest rate, but those that began on a travel stop.

    Force at its turn less force at the breakaway in the new direction. Karnopp's stem moves at the turn with
    F - k x - F_0 = F_c + F_v v, coasts on by (at most) F_v v / k, and breaks away at -F_s: the range lies between
    F_c + F_s and F_c + F_s + F_v v, on slow ramps at F_c + F_s (with F_v DV, as the stem stops below DV). Turned on
    the verge of a breakaway (stick-slip) it is 2 F_s, the most that there is.
    """
    found = []
    for breakaway in phases.breakaways:
        before = _motion_before(samples, phases, breakaway)
        if before is None or before.direction == breakaway.direction or _on_stop(samples, breakaway, stops):
            continue
        turn_n = _turn(samples, before.direction, before.first, breakaway.row)
        force_n, rate_n_per_s = force_at(samples, phases, breakaway)
        range_n = before.direction * (turn_n - force_n)
        usual_n = 3.0 * abs(rate_n_per_s) * samples.period_s + 6.0 * samples.force_noise_n
        if range_n > 0.0 and _leap(samples, breakaway.row) <= _LARGEST_LEAP * range_n + usual_n:
            open_n = max(abs(rate_n_per_s) * breakaway.within_s, _leap(samples, breakaway.row) / math.sqrt(12.0))
            timing_n = math.hypot(open_n, samples.force_noise_n / 2.0)
            before_n_per_s = float(np.median(np.abs(phases.force_rate[before.rows])))
            found.append(Reversal(range_n, timing_n, max(before_n_per_s, abs(rate_n_per_s))))
    slowest = min((one.rate_n_per_s for one in found), default=0.0)
    return [one for one in found if one.rate_n_per_s <= _RATES_APART * slowest]


def dead_band(found: list[Reversal], soft_n: float) -> Measured | None:
    """Mean range of the reversals, N; None without any. ``soft_n`` is what softness_n says.

    Its error is the scatter of the mean and the timing error, which all reversals share where the ramps are in step
    with the samples.
    """
    if not found:
        return None
    ranges = np.array([one.range_n for one in found])
    timing_n = max(float(np.median([one.timing_n for one in found])), soft_n)
    if ranges.size < 2:
        return Measured(float(ranges[0]), timing_n)
    scatter = float(ranges.std(ddof=1)) / math.sqrt(ranges.size)
    if scatter <= timing_n:
        return Measured(float(ranges.mean()), math.hypot(scatter, timing_n))
    return Measured(float(ranges.mean()), scatter, ranges.size - 1.0).with_error(timing_n)


def softness_n(samples: Samples, phases: Phases) -> float:
    """How much the force changes, N, while a stem that starts softly comes out of the noise; the median breakaway.

    Three quarters of the time from the breakaway that was found until the stem is away by 9 noises. 0 for a jump.
    """
    if samples.position_noise_m == 0.0:
        return 0.0
    soft = []
    for one in phases.breakaways:
        last = min(one.row + _SOFT_ROWS, int(samples.run_last[one.row]))
        away_m = one.direction * (samples.position_m[one.row : last + 1] - one.rest_m)
        clear = np.flatnonzero(away_m > _CLEAR_SIGMAS * samples.position_noise_m)
        if clear.size and clear[0] > 1:
            late_s = float(samples.time_s[one.row + int(clear[0])]) - one.time_s
            soft.append(0.75 * late_s * abs(float(phases.force_rate[one.row])))
        else:
            soft.append(0.0)
    return float(np.median(soft)) if soft else 0.0


def _motion_before(samples: Samples, phases: Phases, breakaway: Breakaway) -> Stretch | None:
    before = [one for one in phases.stretches if one.last <= breakaway.row]
    if not before or samples.run_first[before[-1].last] != samples.run_first[breakaway.row]:
        return None
    driven = [one for one in before if one.driven and one.direction == before[-1].direction]
    return driven[-1] if driven else before[-1]


def _leap(samples: Samples, row: int) -> float:
    """Largest change of the force between samples about a row, N."""
    first, last = max(row - 3, int(samples.run_first[row])), min(row + 3, int(samples.run_last[row]))
    return float(np.abs(np.diff(samples.force_n[first : last + 1])).max(initial=0.0))


def _on_stop(samples: Samples, breakaway: Breakaway, stops: TravelStops | None) -> bool:
    if stops is None:
        return False
    near_m = 6.0 * samples.position_noise_m + 1.0e-3 * float(np.ptp(samples.position_m))
    return breakaway.rest_m > stops.high_m - near_m or breakaway.rest_m < stops.low_m + near_m


def _turn(samples: Samples, direction: int, first: int, last: int) -> float:
    """Extreme force between two rows, N: where the lines on either side of it meet, else of the samples themselves."""
    towards = direction * samples.force_n[first : last + 1]
    corner = first + int(np.argmax(towards))
    extreme_n = float(samples.force_n[corner])
    gap = _gap(samples, slice(max(first, corner - _LINE_ROWS), corner + 1))
    sides = (
        slice(max(first, corner - gap - _LINE_ROWS), corner - gap),
        slice(corner + gap + 1, min(last, corner + gap + _LINE_ROWS) + 1),
    )
    lines = [_line(samples, rows, corner) for rows in sides]
    if lines[0] is None or lines[1] is None:
        return extreme_n
    (level_0, slope_0), (level_1, slope_1) = lines[0], lines[1]
    if slope_0 * slope_1 >= 0.0:
        # a force that is held at its end, and not turned at once
        beside = slice(max(first, corner - 3), min(last, corner + 3) + 1)
        return float(np.median(samples.force_n[beside])) if samples.force_noise_n > 0.0 else extreme_n
    at_s = (level_1 - level_0) / (slope_0 - slope_1)
    within = _FEWEST_ROWS * samples.period_s + 3.0 * samples.force_noise_n / min(abs(slope_0), abs(slope_1))
    return level_0 + slope_0 * at_s if abs(at_s) <= within else extreme_n


def _gap(samples: Samples, rows: slice) -> int:
    """Rows beside the largest sample of a noisy force that may lie beyond the true corner: two noises of its slope."""
    count = rows.stop - rows.start
    if samples.force_noise_n == 0.0 or count < _FEWEST_ROWS:
        return 0
    rise_n = float(np.ptp(samples.force_n[rows])) / count
    return min(_LINE_ROWS // 3, math.ceil(2.0 * samples.force_noise_n / rise_n)) if rise_n > 0.0 else 0


def _line(samples: Samples, rows: slice, corner: int) -> tuple[float, float] | None:
    """Force at the corner's row and its slope by the line through these rows, N and N/s; None where it bends."""
    time_s = samples.time_s[rows] - samples.time_s[corner]
    force_n: FloatArray = samples.force_n[rows]
    if time_s.size < _FEWEST_ROWS:
        return None
    middle_s, middle_n = float(time_s.mean()), float(force_n.mean())
    spread_s = time_s - middle_s
    slope = float(spread_s @ force_n) / float(spread_s @ spread_s)
    off_n = force_n - middle_n - slope * spread_s
    limit_n = _STRAIGHT * samples.force_noise_n + 1.0e-6 * float(np.ptp(force_n)) + 1.0e-9 * abs(middle_n)
    return (middle_n - slope * middle_s, slope) if float(np.sqrt(np.mean(off_n**2))) <= limit_n else None
