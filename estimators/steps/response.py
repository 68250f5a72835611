"""Step tests: how soon and how well the stem answers each step of the input (ISA-75.25.01 sense)."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.samples import FloatArray, IntArray, position_noise
from estimators.steps.answer import StepAnswer, answer_to
from estimators.steps.inputs import find_steps
from estimators.steps.resolution import resolution
from valve.messages import joined, say
from valve.nameplate import Nameplate
from valve.recording import Recording

# Own choices.
_LARGE_SHARE: Final = 0.25  # of the largest change
_STROKE_PERCENT: Final = 80.0  # of rated travel: a step that moves the stem by as much shows its stroke time
_LEAST_MOTION: Final = 1.0e-5  # of the travel: less is rounding
_NO_SPAN: Final = say("span_of_steps_unknown", "the span is unknown: give signal.range_pa on the nameplate")
_ONWARD: Final = say("step_onward", "step in the direction of the motion")
_AGAINST: Final = say("step_back", "step against the direction of the motion")
_WAYS: Final = {"opening": say("opening", "opening"), "closing": say("closing", "closing")}


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
        if name == "force_n" and not _come_to_rest(answers):
            continue
        return _to_json(name, answers, _input_span(name, nameplate), nameplate.actuator.travel_m)
    return None


def _come_to_rest(answers: list[StepAnswer]) -> bool:
    """Whether the stem mostly came to rest while the force was held: a driven rod goes on until it is turned back.

    The force on such a rod is what its friction answers with, and steps where the machine reverses it.
    """
    moved = [one for one in answers if one.moved]
    return 2 * sum(one.settled for one in moved) >= len(moved)


def _runs(time_s: FloatArray, rows: IntArray) -> IntArray:
    step_s = np.diff(time_s)
    broken = (np.diff(rows) > 1) & (step_s > 4.0 * float(np.median(step_s)))
    firsts = np.concatenate([[0], np.flatnonzero(broken) + 1])
    lengths = np.diff(np.concatenate([firsts, [rows.size]]))
    return np.asarray(np.repeat(firsts, lengths), dtype=np.int64)


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
    summary["stroke_time_s"] = _stroke_time(each)
    if span is None:
        missing = {"value": None, "ci95": None, "note": _NO_SPAN}
        summary |= {"resolution_percent": missing, "dead_band_percent": missing}
    else:
        fine, reverse = resolution(answers, span[1] - span[0], travel_m)
        summary["resolution_percent"] = fine.to_json(_ONWARD)
        summary["dead_band_percent"] = reverse.to_json(_AGAINST)
    if len(moved) < len(each):
        summary["note"] = say(
            "steps_moved_nothing",
            "{count} of {all} steps moved nothing: below the resolution or dead band",
            count=len(each) - len(moved),
            all=len(each),
        )
    return {"input": name, "each": each, "summary": summary}


def _step_json(one: StepAnswer, span: tuple[float, float] | None, travel_m: float) -> dict[str, Any]:
    share = None if span is None else 100.0 / (span[1] - span[0])
    where = None if span is None or share is None else share * (one.step.after - span[0])
    timed = {"dead_time": one.dead_time, "t63": one.times[0], "t86": one.times[1], "t98": one.times[2]}
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


def _stroke_time(each: list[dict[str, Any]]) -> dict[str, Any]:
    """How long a stroke takes each way, s: T98 of the slowest step over most of the rated travel, dead time included.

    A direction is None where no such step is, or none after which the stem came to rest; ``note`` says which.
    """
    found: dict[str, Any] = {}
    notes = []
    for way, sign in (("opening", 1.0), ("closing", -1.0)):
        strokes = [one for one in each if sign * one["change_percent"] >= _STROKE_PERCENT]
        rested = [one for one in strokes if one["settled"] and one["t98_s"] is not None]
        slowest = max(rested, key=lambda one: float(one["t98_s"]), default=None)
        found[way] = None
        if slowest is not None:
            half_s = NORMAL_95 * slowest["t98_std_error_s"]
            found[way] = {
                "value": slowest["t98_s"],
                "ci95": [max(0.0, slowest["t98_s"] - half_s), slowest["t98_s"] + half_s],
            }
        elif strokes:
            notes.append(say("stem_still_moved", "{way}: the stem still moved when the step ended", way=_WAYS[way]))
        else:
            notes.append(
                say(
                    "no_stroke",
                    "{way}: no step moved the stem over {percent:g} % of its rated travel",
                    way=_WAYS[way],
                    percent=_STROKE_PERCENT,
                )
            )
    return {**found, "note": joined("; ", notes) if notes else ""}
