"""A completed test judged with what the store knows of its valve."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any, Final

from service.health.assess import assess
from service.health.changes import ValveFacts
from service.health.limits import HealthLimits
from service.health.results import Case, Ne107
from service.runs.run import Run
from service.settings import PlantValve
from service.store.figure_table import FigureTable, conditions_of

_HISTORY: Final = 60  # tests that a trend is drawn of: two months of nights
_NARROWING: Final = frozenset({"low_pa", "high_pa", "levels_percent"})
_DAY_S: Final = 86400.0


def health_of(figures: FigureTable, valve: PlantValve, run: Run, analysis: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``analysis.health`` of a test that is not stored as completed yet; reads the database and blocks."""
    conditions = conditions_of(run)
    baseline = figures.baseline(run.valve, conditions)
    earlier = [one for one in figures.newest(run.valve, _HISTORY, conditions=conditions) if one.test_id != run.id]
    since = [one for one in reversed(earlier) if baseline is None or one.at >= baseline.test.at]
    case = Case(
        analysis,
        run.created_at,
        facts_of(valve),
        valve.health,
        None if baseline is None or baseline.test.test_id == run.id else baseline,
        tuple(since),
        is_full_stroke=not _NARROWING & run.overrides.keys(),
    )
    return assess(case).to_json()


def facts_of(valve: PlantValve) -> ValveFacts:
    """Return what of a valve its limits are relative to."""
    plate, allowed_pa = valve.nameplate, valve.wiring.limits.pressure_pa
    span = plate.actuator.bench_set_pa if plate.signal is None else plate.signal.range_pa
    return ValveFacts(
        plate.actuator.travel_m, None if span is None else span[1] - span[0], allowed_pa[1] - allowed_pa[0]
    )


def standing_state(state: str | None, last_at: datetime, now: datetime, limits: HealthLimits) -> str | None:
    """Return a state as it stands today: what was normal long ago is no longer known to be."""
    is_stale = (now - last_at).total_seconds() > limits.stale_days * _DAY_S
    return Ne107.FUNCTION_CHECK.value if is_stale and state == Ne107.NORMAL.value else state


def standing_health(
    health: Mapping[str, Any] | None, last_at: datetime, now: datetime, limits: HealthLimits
) -> Mapping[str, Any] | None:
    """Return health as it stands today, with a reason where it is too old."""
    days = (now - last_at).total_seconds() / _DAY_S
    if health is None or days <= limits.stale_days:
        return health
    stale = f"The last test is {days:.0f} days old, {limits.stale_days:.3g} are allowed: test the valve."
    shown = standing_state(health.get("ne107"), last_at, now, limits)
    return {**health, "ne107": shown, "reasons": [*health.get("reasons", ()), stale]}
