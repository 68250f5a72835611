"""Trends of a result's figures, and which limit is met soon."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from service.health.changes import Change, allowed
from service.health.results import Case, Finding, Ne107, TrendFound
from service.health.trend import scatter_between, slope_of
from service.model.health_figures import FIGURE_KINDS, Figures
from service.words.sentences import as_heading
from valve.messages import say

_DAY_S: Final = 86400.0
#: Shares of the allowed change that a line has used before a night is told, and before it is a reason for M: a wander
#: looks like a trend for some nights, and does not get there (`make bench ARGS=trends`).
TOLD: Final = 0.5
BEYOND: Final = 0.7
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
