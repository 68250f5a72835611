"""A completed test judged with what the store knows of its valve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from service.config.plant import PlantValve
from service.health.assess import assess
from service.health.changes import facts_of
from service.health.results import Case
from service.model.family_rule import event_of_early
from service.model.run import Run
from service.store.figure_table import FigureTable, conditions_of

_HISTORY: Final = 60  # tests that a trend is drawn of: two months of nights
_NARROWING: Final = frozenset({"low_pa", "high_pa", "levels_percent"})


def health_of(figures: FigureTable, valve: PlantValve, run: Run, analysis: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``analysis.health`` of a test that is not stored as completed yet; reads the database and blocks."""
    conditions = conditions_of(run)
    baseline = figures.baseline(run.valve, conditions)
    earlier = [one for one in figures.newest(run.valve, _HISTORY, conditions=conditions) if one.at < run.created_at]
    since = [one for one in reversed(earlier) if baseline is None or one.at >= baseline.test.at]
    case = Case(
        analysis,
        run.created_at,
        facts_of(valve),
        valve.health,
        None if baseline is None or baseline.test.test_id == run.id else baseline,
        tuple(since),
        is_full_stroke=not _NARROWING & run.overrides.keys(),
        out_of_family=event_of_early(run.ended_early),
    )
    return assess(case).to_json()
