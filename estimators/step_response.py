"""Step tests: how soon and how well the stem answers each step of the input (ISA-75.25.01 sense)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.samples import FloatArray, IntArray, position_noise
from estimators.step_inputs import InputStep, find_steps
from valve.nameplate import Nameplate
from valve.recording import Recording

SHARES: Final = (0.632, 0.865)  # of the realised change: T63 and T86
# Own choices.
_MOVED_SIGMAS: Final = 5.0  # of the levels' difference
_HIDDEN_SIGMAS: Final = 3.0  # by which a motion that was called none may have been larger
_SEEN_SIGMAS: Final = 4.5  # of one sample's noise: the stem is on its way
_LEVEL_SHARE: Final = 0.25  # of a hold, at its end: the level that was reached
_SETTLED_SHARE: Final = 0.02  # of the change: what may still come in the last quarter
_LARGE_SHARE: Final = 0.25  # of the largest change
_LEAST_MOTION: Final = 1.0e-5  # of the travel: less is rounding
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


@dataclass(frozen=True, slots=True)
class Bracket:
    """The least input change that moved the stem and the greatest below it that did not, percent of span."""

    moved_percent: float | None
    unmoved_percent: float

    def to_json(self, name: str) -> dict[str, Any]:
        """Return value, interval and the reason where there is none."""
        if self.moved_percent is None:
            tried = f"{self.unmoved_percent:.3g} %" if self.unmoved_percent > 0.0 else "none"
            return {"value": None, "ci95": None, "note": f"no {name} moved the stem (largest tried: {tried})"}
        note = "" if self.unmoved_percent > 0.0 else f"every {name} moved the stem: smaller ones were not tried"
        return {"value": self.moved_percent, "ci95": [self.unmoved_percent, self.moved_percent], "note": note}


def step_figures(recording: Recording, nameplate: Nameplate) -> dict[str, Any] | None:
    """Return ``steps`` of the signature: each step and a summary; None where the input has no steps.

    The input is the command where it was recorded, else the pressure, else the force.
    """
    for name in ("command_pa", "pressure_pa", "force_n"):
        channel = getattr(recording, name)
        if channel is None:
            continue
        rows = np.flatnonzero(np.isfinite(channel) & np.isfinite(recording.position_m))
        if rows.size < 24:
            continue
        time_s, level, position_m = recording.time_s[rows], channel[rows], recording.position_m[rows]
        run_first = _runs(time_s, rows)
        steps = find_steps(time_s, level, run_first)
        if not steps:
            continue
        noise_m = position_noise(time_s, position_m, run_first)
        floor_m = _LEAST_MOTION * nameplate.actuator.travel_m
        answers = [answer_to(one, time_s, position_m, noise_m, floor_m) for one in steps]
        return _to_json(name, answers, _input_span(name, nameplate), nameplate.actuator.travel_m)
    return None


def _runs(time_s: FloatArray, rows: IntArray) -> IntArray:
    step_s = np.diff(time_s)
    broken = (np.diff(rows) > 1) & (step_s > 4.0 * float(np.median(step_s)))
    firsts = np.concatenate([[0], np.flatnonzero(broken) + 1])
    lengths = np.diff(np.concatenate([firsts, [rows.size]]))
    return np.asarray(np.repeat(firsts, lengths), dtype=np.int64)


def answer_to(
    step: InputStep, time_s: FloatArray, position_m: FloatArray, noise_m: float, floor_m: float
) -> StepAnswer:
    """Return the stem's answer to one step; levels are medians over the last quarter of the holds before and after.

    Dead time: from the step to the first observable change. T63, T86: from the step until 63.2 % and 86.5 % of the
    realised change are reached (ANSI/ISA-75.25.01). ``floor_m`` is the least motion that counts.
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
    times = tuple(_reached(clock_s, way_m, share * abs(change_m), noise_m, step) for share in SHARES)
    overshoot, overshoot_error = _overshoot(way_m, abs(change_m), noise_m, error_m)
    return StepAnswer(step, True, start_m, end_m, error_m, settled, dead_time, times, overshoot, overshoot_error)


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


def resolution(answers: list[StepAnswer], span: float, travel_m: float) -> tuple[Bracket, Bracket]:
    """Resolution and dead band from the steps, percent of span.

    Steps add up until the stem moves, so what counts is the input's change since it last moved: in the direction
    of that motion for the resolution, against it for the dead band. Karnopp's stem, if damped, comes to rest with
    F - k x - F_0 = A = F_c + F_v DV: the resolution is (F_s - A)/(S_a span), the dead band (F_s + A)/(S_a span).
    A step that moved nothing beyond noise may have moved the stem by that: so much less is what surely did not.
    """
    onward: list[tuple[float, bool]] = []
    back: list[tuple[float, bool]] = []
    heading, since = 0.0, 0.0
    for one in answers:
        since += one.step.size
        if heading != 0.0 and since != 0.0:
            unseen = 0.0 if one.moved else 100.0 * (abs(one.change_m) + _HIDDEN_SIGMAS * one.level_error_m) / travel_m
            tried = max(0.0, 100.0 * abs(since) / span - unseen)
            (onward if since * heading > 0.0 else back).append((tried, one.moved))
        if one.moved:
            heading, since = math.copysign(1.0, one.change_m), 0.0
    return _bracket(onward), _bracket(back)


def _bracket(tried: list[tuple[float, bool]]) -> Bracket:
    moved = [size for size, motion in tried if motion]
    least = min(moved) if moved else None
    unmoved = [size for size, motion in tried if not motion and (least is None or size < least)]
    return Bracket(least, max(unmoved, default=0.0))


def _input_span(name: str, nameplate: Nameplate) -> tuple[float, float] | None:
    """Input at 0 and at 100 %, in the input's unit."""
    range_pa = nameplate.actuator.bench_set_pa if nameplate.signal is None else nameplate.signal.range_pa
    if range_pa is None or name != "force_n":
        return range_pa
    area_m2 = nameplate.actuator.diaphragm_area_m2
    return None if area_m2 is None else (area_m2 * range_pa[0], area_m2 * range_pa[1])


def _to_json(name: str, answers: list[StepAnswer], span: tuple[float, float] | None, travel_m: float) -> dict[str, Any]:
    each = [_step_json(one, span, travel_m) for one in answers]
    moved = [one for one in each if one["moved"]]
    largest = max((abs(one["change_percent"]) for one in moved), default=0.0)
    # a fine step slips by a jump of its own: what a step test times are the large ones
    large = [one for one in moved if abs(one["change_percent"]) >= _LARGE_SHARE * largest]
    summary: dict[str, Any] = {"count": len(each), "moved": len(moved), "timed": len(large)}
    for key in ("dead_time_s", "dead_time_below_s", "t63_s", "t86_s", "overshoot_percent", "steady_error_percent"):
        values = [one[key] for one in (each if key == "steady_error_percent" else large) if one[key] is not None]
        summary[key] = float(np.median(values)) if values else None
    if span is None:
        missing = {"value": None, "ci95": None, "note": "the span is unknown: give signal.range_pa on the nameplate"}
        summary |= {"resolution_percent": missing, "dead_band_percent": missing}
    else:
        fine, reverse = resolution(answers, span[1] - span[0], travel_m)
        summary["resolution_percent"] = fine.to_json("step in the direction of the motion")
        summary["dead_band_percent"] = reverse.to_json("step against the direction of the motion")
    if len(moved) < len(each):
        summary["note"] = (
            f"{len(each) - len(moved)} of {len(each)} steps moved nothing: below the resolution or dead band"
        )
    return {"input": name, "each": each, "summary": summary}


def _step_json(one: StepAnswer, span: tuple[float, float] | None, travel_m: float) -> dict[str, Any]:
    share = None if span is None else 100.0 / (span[1] - span[0])
    where = None if span is None or share is None else share * (one.step.after - span[0])
    timed = {"dead_time": one.dead_time, "t63": one.times[0], "t86": one.times[1]}
    found: dict[str, Any] = {
        "time_s": one.step.time_s,
        "input": [one.step.before, one.step.after],
        "step_percent": None if share is None else share * one.step.size,
        "travel_m": [one.start_m, one.end_m],
        "change_percent": 100.0 * one.change_m / travel_m,
        "moved": one.moved,
        "settled": one.settled,
        "overshoot_percent": one.overshoot_percent,
        "overshoot_std_error_percent": one.overshoot_error_percent,
        "steady_error_percent": None if where is None else 100.0 * one.end_m / travel_m - where,
    }
    dead = one.dead_time
    found["dead_time_below_s"] = None
    if dead is not None and dead.value_s <= NORMAL_95 * dead.std_error_s * (1.0 + 1.0e-9):
        # none at all is as likely: a bound is all that is known
        found["dead_time_below_s"], timed["dead_time"] = dead.value_s + NORMAL_95 * dead.std_error_s, None
    for key, value in timed.items():
        told = None if value is None else asdict(value)
        found[f"{key}_s"] = None if told is None else told["value_s"]
        found[f"{key}_std_error_s"] = None if told is None else told["std_error_s"]
    return found
