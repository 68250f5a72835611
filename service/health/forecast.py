"""Trends of a result's figures, and which limit is met soon."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from service.health.changes import Change, allowed
from service.health.results import Case, Finding, Ne107, TrendFound
from service.health.trend import robust_slope, scatter_between
from service.model.health_figures import FIGURE_KINDS, Figures

_DAY_S: Final = 86400.0


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
    slope = robust_slope(times, [value for _, value in past] + [now[name].value])
    if slope is None:
        return None
    was = held.get(name)
    limit_at = None
    if was is not None:
        up, down = allowed(name, was, case.limits, case.valve)
        room = up if slope.per_day > 0.0 else down
        days = (case.at - times[0]).total_seconds() / _DAY_S
        # a friction that wanders shows a slope for some nights, no further than two tests may differ
        reach = math.hypot(was.half_width or 0.0, now[name].half_width or 0.0)
        if room is not None and abs(slope.per_day) * days > reach:
            limit_at = slope.reaches(was.value + (room if slope.per_day > 0.0 else -room))
    return TrendFound(name, slope, len(times), limit_at)


def forecasts(case: Case, trends: Sequence[TrendFound], changes: Sequence[Change]) -> Iterator[Finding]:
    """Yield a finding for each figure that its trend brings to its limit within ``forecast_days``."""
    beyond = {one.name for one in changes if not one.kept}
    for one in trends:
        if one.limit_at is None or one.name in beyond:
            continue
        if (one.limit_at - case.at).total_seconds() <= case.limits.forecast_days * _DAY_S:
            words = FIGURE_KINDS[one.name].words
            yield Finding(
                Ne107.MAINTENANCE,
                f"{words[0].upper()}{words[1:]} runs to its limit: by the trend of {one.tests} tests it gets there "
                f"about {one.limit_at:%Y-%m-%d}.",
            )
