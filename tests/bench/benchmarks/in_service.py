"""Valves watched in service: whether the interval of friction holds the truth, how near it is, and how long it takes.

Loops of usual packings under a PI controller with disturbances, IN_SERVICE_HOURS hours each (2 by default), rows at 1,
10 and 50 Hz, and as a historian reports them: where position or pressure changed by more than a dead band. The number
after the name is that of the loops a line. Times are of the processor.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.table import Table

from estimators.in_service.result import Scale
from estimators.in_service.watch import watched
from tests.bench.parallel import each
from tests.support.loops import Loop, loop, reported_by_exception
from valve.errors import MeasurementError
from valve.recording import Recording

COUNT: Final = 20
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "2000"))
HOURS: Final = float(os.environ.get("IN_SERVICE_HOURS", "2"))
GRADES: Final = tuple(os.environ.get("IN_SERVICE_GRADES", "usual").split(","))
VALVES: Final = tuple(os.environ.get("IN_SERVICE_VALVES", "small,large,graphite,nominal,vendor").split(","))
PERIOD_S: Final = float(os.environ.get("IN_SERVICE_PERIOD_S", "0.02"))  # of the loop; slower rows are taken from these
BY_EXCEPTION: Final = "1 s, by exception"
LINES: Final = {"50 Hz": 0.02, "10 Hz": 0.1, "1 Hz": 1.0, BY_EXCEPTION: 1.0}
FIGURES: Final = ("friction", "breakaway", "spring_rate")
LEAST_MOVED: Final = 0.02  # of the travel an hour: a valve that moves less is asked for nothing

Case = tuple[str, str, int]


@dataclass(frozen=True, slots=True)
class Judged:
    """One loop: for each figure error and half width (% of the truth) and whether it held, or None."""

    given: dict[str, tuple[float, float, bool] | None]
    moved: float  # share of the travel an hour
    took_s: float


def truths(made: Loop) -> dict[str, float]:
    """What the figures are judged by; friction in the slowest motion that a stem has, F_c + F_v DV."""
    one = made.truth.parameters
    slowest_n = one.viscous_friction_n_s_per_m * one.limit_velocity_m_per_s
    return {
        "friction": one.coulomb_friction_n + slowest_n,
        "breakaway": one.static_friction_n,
        "spring_rate": one.spring_rate_n_per_m,
    }


def judge(case: Case) -> dict[str, Judged]:
    """Simulate a loop and judge what watching it gives, by rate of the rows."""
    valve, grade, seed = case
    # a valve with more friction is moved by more, or its loop does nothing but wait
    made = loop(valve, HOURS, PERIOD_S, seed, grade=grade, disturbance=0.06 if valve == "nominal" else 0.03)
    found = {}
    for line, period_s in LINES.items():
        if period_s < PERIOD_S:
            continue
        slower = replace(made, recording=made.recording.rows(slice(None, None, round(period_s / PERIOD_S))))
        recording = reported_by_exception(slower) if line == BY_EXCEPTION else slower.recording
        found[line] = _judged(recording, made)
    return found


def _judged(recording: Recording, made: Loop) -> Judged:
    actuator, true = made.nameplate.actuator, truths(made)
    scale = Scale(actuator.travel_m, actuator.diaphragm_area_m2)
    began_s = time.process_time()
    try:
        found = watched(recording, made.nameplate, scale, subject=made.nameplate.tag)
    except MeasurementError:
        return Judged(dict.fromkeys(FIGURES), 0.0, time.process_time() - began_s)
    took_s = time.process_time() - began_s
    given: dict[str, tuple[float, float, bool] | None] = {}
    for name in FIGURES:
        one = found.figures[name]
        if one.value is None or one.ci95 is None:
            given[name] = None
            continue
        low, high = one.ci95
        error, half = one.value - true[name], 0.5 * (high - low)
        given[name] = (100.0 * error / true[name], 100.0 * half / true[name], low <= true[name] <= high)
    return Judged(given, found.travel.per_hour / actuator.travel_m, took_s)


def run(count: int | None = None) -> Table:
    """Return the table: a line a valve and rate, the figures side by side."""
    seeds = range(FIRST_SEED, FIRST_SEED + (COUNT if count is None else count))
    kinds = [(valve, grade) for grade in GRADES for valve in VALVES]
    cases = [(*kind, seed) for kind in kinds for seed in seeds]
    judged = dict(zip(cases, each(judge, cases, "in service"), strict=True))
    table = Table(
        title=f"Watched in service: {len(seeds)} loops of {HOURS:g} h a valve; intervals that hold, of those given, "
        "median error and half width in %",
        caption="all: the valves that move more than 2 % of their travel an hour",
        title_justify="left",
    )
    for heading in ("valve", "rows", "travel an hour", *FIGURES, "worst s"):
        table.add_column(heading, justify="left" if heading in ("valve", "rows") else "right")
    every = list(judged.values())
    for valve, grade in kinds:
        for line in every[0]:
            own = [judged[valve, grade, seed][line] for seed in seeds]
            named = valve if len(GRADES) == 1 else f"{valve}, {grade}"
            table.add_row(
                named,
                line,
                f"{100.0 * np.median([one.moved for one in own]):.0f} %",
                *(_cell(own, name) for name in FIGURES),
                f"{max(one.took_s for one in own):.1f}",
            )
    table.add_section()
    for line in [*every[0], "all"]:
        own = [one for by_line in every for name, one in by_line.items() if line in (name, "all")]
        own = [one for one in own if one.moved > LEAST_MOVED]
        worst_s = f"{max(one.took_s for one in own):.1f}"
        table.add_row("all", line, "", *(_cell(own, name) for name in FIGURES), worst_s)
    return table


def _cell(own: list[Judged], name: str) -> str:
    known = [value for one in own if (value := one.given[name]) is not None]
    if not known:
        return "none given"
    held = sum(value[2] for value in known)
    errors, half = [abs(value[0]) for value in known], np.median([value[1] for value in known])
    missing = len(own) - len(known)
    return f"{held}/{len(known)}{f' ({missing} not known)' if missing else ''}, {np.median(errors):.1f} ± {half:.1f}"
