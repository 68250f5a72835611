"""Trends and steps of a result's figures, and which limit is met soon."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Final

import numpy as np

from service.health.changes import Change, allowed
from service.health.results import Case, Finding, Ne107, StepFound, TrendFound
from service.health.step import steps_at
from service.health.trend import slope_of
from service.health.wander import scatter_between
from service.model.health_figures import FIGURE_KINDS, Figures
from service.words.sentences import as_heading
from service.words.units import measured_said, quantity_said
from valve.messages import Value, say

_DAY_S: Final = 86400.0
#: Shares of the allowed change that a line has used before a night is told, and before it is a reason for M: a wander
#: looks like a trend for some nights, and does not get there (`make bench ARGS=trends`).
TOLD: Final = 0.5
BEYOND: Final = 0.7
#: Share of the allowed change that a step must have to be told: a smaller one may as well be a wander of some nights.
STEP: Final = 1.0 / 3.0
#: Times ``forecast_days`` that the interval may reach for M.
LATEST: Final = 3.0


def trends_of(case: Case, was: Figures | None, now: Figures) -> list[TrendFound]:
    """Return the trend of each figure that has tests and days enough for one; ``was`` are the baseline's figures."""
    found = [_trend(case, was or {}, now, name) for name in FIGURE_KINDS if name in now]
    return [one for one in found if one is not None]


def scatter_of(case: Case, now: Figures) -> dict[str, float]:
    """How much each figure differs from one test to the next, by the tests since the baseline; in the figure's unit."""
    past = {name: [one.figures[name].value for one in case.history if name in one.figures] for name in now}
    return {name: scatter_between([*values, now[name].value]) for name, values in past.items()}


def _trend(case: Case, held: Figures, now: Figures, name: str) -> TrendFound | None:
    past = [(one.at, one.figures[name].value) for one in case.history if name in one.figures]
    times = [at for at, _ in past] + [case.at]
    slope = slope_of(times, [value for _, value in past] + [now[name].value])
    if slope is None:
        return None
    was = held.get(name)
    room = None if was is None else allowed(name, was, case.limits, case.valve)[0 if slope.per_day > 0.0 else 1]
    if was is None or not room:
        return TrendFound(name, slope, None)
    room = math.copysign(room, slope.per_day)
    used = (slope.last - was.value) / room
    # what moved no further than two tests may differ may be a wander
    reach = math.hypot(was.half_width or 0.0, now[name].half_width or 0.0)
    is_far = used >= TOLD and abs(slope.last - was.value) > reach
    return TrendFound(name, slope, slope.reaches(was.value + room) if is_far else None, used)


def forecasts(case: Case, trends: Sequence[TrendFound], changes: Sequence[Change]) -> Iterator[Finding]:
    """Yield a finding for each figure that its trend brings to its limit within ``forecast_days``.

    Its line must have used ``BEYOND`` of what is allowed, and its interval end within ``LATEST`` times those days.
    """
    beyond = {one.name for one in changes if not one.kept}
    for one in trends:
        if one.crossing is None or one.name in beyond or one.share_used < BEYOND or one.crossing.latest is None:
            continue
        days, latest_days = ((at - case.at).total_seconds() / _DAY_S for at in (one.crossing.at, one.crossing.latest))
        if days <= case.limits.forecast_days and latest_days <= LATEST * case.limits.forecast_days:
            yield Finding(
                Ne107.MAINTENANCE,
                say(
                    "runs_to_limit",
                    "{figure} runs to its limit: by the trend of {tests} tests it gets there about {day}.",
                    figure=as_heading(FIGURE_KINDS[one.name].words),
                    tests=one.slope.tests,
                    day=f"{one.crossing.at:%Y-%m-%d}",
                ),
            )


def steps_of(case: Case, was: Figures | None, now: Figures) -> list[StepFound]:
    """Return the figures whose newest tests lie above or below all before them; ``was`` are the baseline's figures."""
    names = [name for name in FIGURE_KINDS if name in now and name in (was or {})]
    by_times: dict[tuple[datetime, ...], list[str]] = {}
    for name in names:
        times = (*(one.at for one in case.history if name in one.figures), case.at)
        by_times.setdefault(times, []).append(name)
    found = [step for times, alike in by_times.items() for step in _steps(case, was or {}, now, times, alike)]
    steps = {one.name: one for one in found}
    if "friction_mean_n" in steps:  # the others say the same
        steps = {name: one for name, one in steps.items() if name not in ("friction_max_n", "friction_coulomb_n")}
    return [steps[name] for name in names if name in steps]


def _steps(
    case: Case, was: Figures, now: Figures, times: Sequence[datetime], names: Sequence[str]
) -> Iterator[StepFound]:
    """Yield the steps of figures that the same tests have."""
    limits = {name: allowed(name, was[name], case.limits, case.valve) for name in names}
    least = [[math.inf if way is None else STEP * way for way in limits[name]] for name in names]
    past = [one.figures for one in case.history if names[0] in one.figures]
    values = np.array([[figures[name].value for name in names] for figures in (*past, now)])
    for name, step in zip(names, steps_at(times, values, np.array(least).T), strict=True):
        if step is not None:
            limit = limits[name][0 if step.change > 0.0 else 1]
            assert limit is not None
            yield StepFound(name, step, limit)


def told_steps(steps: Sequence[StepFound], trends: Sequence[TrendFound], changes: Sequence[Change]) -> Iterator[str]:
    """Yield a sentence for each step within what is allowed; where a line is sure, the trend tells of it."""
    beyond = {one.name for one in changes if not one.kept} | {one.name for one in trends if one.slope.is_sure}
    for one in steps:
        if one.name in beyond:
            continue
        kind, step = FIGURE_KINDS[one.name], one.step
        moved = measured_said(abs(step.change), one.size_ci95, kind.unit)
        if step.before != 0.0:
            share = 100.0 * abs(step.change / step.before)
            moved = say("moved_by_share", "{moved} ({share:.3g} %)", moved=moved, share=share)
        quantities: dict[str, Value] = {
            "figure": as_heading(kind.words),
            "day": f"{step.since:%Y-%m-%d}",
            "tests": step.tests,
            "moved": moved,
            "limit": quantity_said(one.limit, kind.unit, 3),
        }
        if step.change > 0.0:
            yield say(
                "step_up",
                "{figure}: since {day}, over {tests} tests, {moved} higher than before; {limit} above the baseline "
                "is allowed.",
                **quantities,
            )
        else:
            yield say(
                "step_down",
                "{figure}: since {day}, over {tests} tests, {moved} lower than before; {limit} below the baseline "
                "is allowed.",
                **quantities,
            )
