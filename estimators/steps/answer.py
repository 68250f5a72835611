"""How a stem answers one step: levels before and after, dead time, T63, T86 and T98, overshoot (ISA-75.25.01 sense)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.samples import FloatArray
from estimators.steps.inputs import InputStep

SHARES: Final = (0.632, 0.865, 0.98)  # of the realised change: T63, T86 and T98, where a stroke counts as done
# Own choices.
_MOVED_SIGMAS: Final = 5.0  # of the levels' difference
_SEEN_SIGMAS: Final = 4.5  # of one sample's noise: the stem is on its way
_LEVEL_SHARE: Final = 0.25  # of a hold, at its end: the level that was reached
_SETTLED_SHARE: Final = 0.02  # of the change: what may still come in the last quarter
_RESOLVED: Final = 3.0  # samples that a crossing must be apart from the step for a line between samples


@dataclass(frozen=True, slots=True)
class Timed:
    """A time after the step, s; 1.96 times its standard error holds the bounds that the sampling leaves, and noise."""

    value_s: float
    std_error_s: float


@dataclass(frozen=True, slots=True)
class StepAnswer:
    """What one step did. Sizes in the input's unit and m; None where the stem did not move or it cannot be told."""

    step: InputStep
    moved: bool
    start_m: float
    end_m: float
    level_error_m: float
    settled: bool
    dead_time: Timed | None
    times: tuple[Timed | None, ...]  # as SHARES
    overshoot_percent: float | None
    overshoot_error_percent: float | None

    @property
    def change_m(self) -> float:
        """Realised change, m."""
        return self.end_m - self.start_m


def answer_to(
    step: InputStep, time_s: FloatArray, position_m: FloatArray, noise_m: float, floor_m: float
) -> StepAnswer:
    """Return the stem's answer to one step; levels are medians over the last quarter of the holds before and after.

    Dead time: from the step to the first observable change. T63, T86, T98: from the step until 63.2 %, 86.5 % and
    98 % of the realised change are reached (the first two by ANSI/ISA-75.25.01). ``floor_m`` is the least motion that
    counts. ``time_s``, ``position_m``: shape (n,).
    """
    begin = step.row - int(_LEVEL_SHARE * (step.row - step.first))
    end = step.last - int(_LEVEL_SHARE * (step.last - step.row))
    before, after = position_m[begin : step.row + 1], position_m[end : step.last + 1]
    start_m, end_m = float(np.median(before)), float(np.median(after))
    # 1.25: a median scatters that much more than a mean
    error_m = 1.25 * noise_m * math.sqrt(1.0 / before.size + 1.0 / after.size)
    change_m = end_m - start_m
    half = after.size // 2
    drift_m = abs(float(np.median(after[half:])) - float(np.median(after[:half]))) if half else 0.0
    settled = drift_m <= _SETTLED_SHARE * abs(change_m) + 4.0 * noise_m / math.sqrt(max(1, half))
    if abs(change_m) <= max(_MOVED_SIGMAS * error_m, floor_m):
        return StepAnswer(step, False, start_m, end_m, error_m, settled, None, (None,) * len(SHARES), None, None)
    way_m = (position_m[step.row : step.last + 1] - start_m) * math.copysign(1.0, change_m)
    clock_s = time_s[step.row : step.last + 1] - step.time_s
    seen_m = max(_SEEN_SIGMAS * noise_m, floor_m, 1.0e-3 * abs(change_m))
    dead_time = None if seen_m > 0.5 * abs(change_m) else _dead_time(clock_s, way_m, seen_m, step)
    times = [_reached(clock_s, way_m, share * abs(change_m), noise_m, step) for share in SHARES]
    if (1.0 - SHARES[-1]) * abs(change_m) < _SEEN_SIGMAS * noise_m:
        times[-1] = None  # what is left of the way then is lost in the noise
    overshoot, overshoot_error = _overshoot(way_m, abs(change_m), noise_m, error_m)
    return StepAnswer(step, True, start_m, end_m, error_m, settled, dead_time, tuple(times), overshoot, overshoot_error)


def _dead_time(clock_s: FloatArray, way_m: FloatArray, seen_m: float, step: InputStep) -> Timed | None:
    """First of the rows from which on the stem is surely away, drawn back to its rest by the way it goes on."""
    away = way_m > seen_m
    # away for good: a lone sample is noise
    sure = away[:-1] & away[1:]
    if not sure.any():
        return None
    row = int(np.argmax(sure))
    middle_s = 0.5 * float(clock_s[row] + clock_s[max(row - 1, 0)])
    gap_s = float(clock_s[row] - clock_s[max(row - 1, 0)])
    later = np.flatnonzero(way_m[row:] >= 3.0 * seen_m)
    back_s = 0.0
    if later.size and int(later[0]) > 0:
        rise_s = float(clock_s[row + int(later[0])] - clock_s[row])
        back_s = min(0.5 * rise_s, max(0.0, middle_s))
    # bounds rather than chances: devices often step and sample at the same tick
    error_s = math.hypot(0.5 * (gap_s + step.sample_s) / NORMAL_95, 0.5 * back_s)
    return Timed(max(0.0, middle_s - back_s), error_s)


def _reached(clock_s: FloatArray, way_m: FloatArray, level_m: float, noise_m: float, step: InputStep) -> Timed | None:
    """When the way passes a level: midway between its first sample above and its last below before it stays there."""
    above = np.flatnonzero(way_m >= level_m)
    if above.size == 0 or above[0] == 0:
        return None
    first = int(above[0])
    # noise lets the path cross more than once; it has passed for good where it is above by the noise
    surely = np.flatnonzero(way_m >= level_m + _SEEN_SIGMAS * noise_m)
    end = int(surely[0]) if surely.size else min(way_m.size - 1, first + 1)
    below = np.flatnonzero(way_m[: max(end, first) + 1] < level_m)
    last = int(below[-1]) + 1 if below.size else first
    crossings = []
    for row in (first, min(last, way_m.size - 1)):
        low_m, high_m = float(way_m[row - 1]), float(way_m[row])
        share = (level_m - low_m) / (high_m - low_m) if high_m > low_m else 1.0
        crossings.append(float(clock_s[row - 1]) + min(1.0, max(0.0, share)) * float(clock_s[row] - clock_s[row - 1]))
    value_s = 0.5 * (crossings[0] + crossings[1])
    gap_s = float(clock_s[first] - clock_s[first - 1])
    # a jump within few samples leaves open when between two of them it was
    bound_s = 0.5 * step.sample_s + (0.5 if value_s < _RESOLVED * gap_s else 0.05) * gap_s
    slope_s = 0.25 * (crossings[1] - crossings[0])
    reach = slice(max(0, first - 3), min(way_m.size, last + 4))
    rise_m = float(way_m[reach].max() - way_m[reach].min())
    noise_s = noise_m / rise_m * float(clock_s[reach][-1] - clock_s[reach][0]) if rise_m > 0.0 else 0.0
    error_s = math.sqrt((bound_s / NORMAL_95) ** 2 + slope_s**2 + noise_s**2)
    return Timed(max(0.0, value_s), error_s)


def _overshoot(way_m: FloatArray, change_m: float, noise_m: float, error_m: float) -> tuple[float, float]:
    """How far the stem went beyond its final level and came back, percent of the change; 0 where noise explains it."""
    excess_m = float(way_m.max()) - change_m
    error = 100.0 * math.hypot(noise_m, error_m) / change_m
    # the largest of n normal values lies sqrt(2 ln n) above their mean
    expected_m = noise_m * math.sqrt(2.0 * math.log(max(2, way_m.size)))
    if excess_m <= expected_m + 3.0 * noise_m + 1.0e-6 * change_m:
        return 0.0, error
    return 100.0 * (excess_m - 0.5 * noise_m) / change_m, error
