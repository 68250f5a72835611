"""What a test would do to a valve, sequence by sequence, before anything moves."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from drivers.waveform_check import check_waveform
from service.config.plant import PlantValve
from service.model.run import Run
from service.model.sequences import SEQUENCES, build_waveform, default_of
from service.model.until import SEPARATING
from service.runs.separating import separating_of
from service.shown.words import SEQUENCES as IN_WORDS
from service.store.store import Store
from valve.errors import RequestError, ValveError
from valve.messages import message_of, say
from valve.waveform import Waveform

_POINTS: Final = 240
#: Approach, return and a device's own upload come on top of the motion asked for, s. Own estimate.
AROUND_S: Final = 15.0


@dataclass(frozen=True, slots=True)
class Plan:
    """One sequence on one valve, or (``problem``) why it cannot be run."""

    name: str
    words: str
    is_default: bool
    duration_s: float = 0.0
    low_pa: float = 0.0
    high_pa: float = 0.0
    line: str = ""
    problem: str = ""


def plans_of(valve: PlantValve, store: Store) -> list[Plan]:
    """Return every sequence, the usual one first and what is impossible last; reads the store, so it may block.

    What the last diagnosis asks for stands second, where it asks for something.
    """
    default, _ = default_of(valve.nameplate, valve.wiring.limits)
    plans = [_plan(valve, name, name, {}, is_default=name == default) for name in SEQUENCES]
    try:
        wish = separating_of(store, valve.nameplate.tag)
    except RequestError:  # there is nothing to separate
        pass
    else:
        plans.insert(0, _plan(valve, SEPARATING, wish.sequence, wish.overrides, is_default=False))
    return sorted(plans, key=lambda plan: (bool(plan.problem), not plan.is_default))


def approved_plans(plans: list[Plan], approved: Collection[str] | None) -> list[Plan]:
    """Return the plans, with those that only an engineer may run marked as impossible and last."""
    if approved is None:
        return plans
    why = say("not_approved_for_you", "not approved for you, ask an engineer")
    marked = [plan if plan.problem or plan.name in approved else replace(plan, problem=why, line="") for plan in plans]
    return sorted(marked, key=lambda plan: bool(plan.problem))


def waveform_of(valve: PlantValve, run: Run, store: Store) -> Waveform:
    """Return what a running test plays; may block. Raises ValveError where the plant file no longer allows it."""
    sequence, overrides = run.sequence, run.overrides
    if sequence == SEPARATING:
        wish = separating_of(store, run.valve)
        sequence, overrides = wish.sequence, wish.overrides
    return build_waveform(sequence, overrides, valve.nameplate, valve.wiring.limits)


def _plan(valve: PlantValve, name: str, sequence: str, overrides: Mapping[str, Any], *, is_default: bool) -> Plan:
    words = IN_WORDS.get(name, "")
    try:
        waveform = build_waveform(sequence, overrides, valve.nameplate, valve.wiring.limits)
        check_waveform(valve.nameplate.tag, waveform, valve.wiring.limits)
    except ValveError as error:
        return Plan(name, words, is_default, problem=message_of(error))
    low_pa, high_pa = waveform.range_pa
    return Plan(name, words, is_default, waveform.duration_s, low_pa, high_pa, _line(waveform))


def _line(waveform: Waveform) -> str:
    """Return the waveform as the points of an SVG polyline, 240 wide and 40 high."""
    corners_s, corners_pa = waveform.time_s, waveform.pressure_pa
    if corners_s.size > _POINTS:
        corners_s = np.linspace(0.0, waveform.duration_s, _POINTS)
        corners_pa = waveform.at(corners_s)
    low_pa, high_pa = waveform.range_pa
    x = 240.0 * corners_s / waveform.duration_s
    y = 38.0 - 36.0 * (corners_pa - low_pa) / max(high_pa - low_pa, 1.0)
    return " ".join(f"{one:.1f},{other:.1f}" for one, other in zip(x.tolist(), y.tolist(), strict=True))


def planned_line(waveform: Waveform) -> dict[str, list[float]]:
    """Return the planned pressure over time for the live trace: at most 240 corners, s and Pa."""
    time_s, pressure_pa = waveform.time_s, waveform.pressure_pa
    if time_s.size > _POINTS:
        time_s = np.linspace(0.0, waveform.duration_s, _POINTS)
        pressure_pa = waveform.at(time_s)
    return {
        "time_s": [round(value, 3) for value in time_s.tolist()],
        "pressure_pa": [round(value, 1) for value in pressure_pa.tolist()],
    }
