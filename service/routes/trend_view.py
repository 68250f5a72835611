"""Figures over tests as the REST interface shows them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, datetime
from typing import Any, Final

from pydantic import BaseModel, Field

from service.model.health_figures import FIGURE_KINDS
from service.model.past_test import PastTest
from service.model.watched_day import WatchedDay

_INSTANT: Final = {"type": ["string", "null"], "format": "date-time"}
#: ``health.trends`` and ``steps`` for the OpenAPI document: results of earlier versions may lack what is new.
HEALTH_SCHEMA: Final[dict[str, Any]] = {
    "properties": {
        "trends": {
            "description": "figures with a trend over the tests since the baseline, SI",
            "items": {
                "properties": {
                    "name": {"type": "string"},
                    "per_day": {"type": "number", "description": "change a day of the line through the tests"},
                    "ci95": {"type": "array", "items": {"type": "number"}, "description": "of per_day"},
                    "tests": {"type": "integer", "description": "tests that the line goes through"},
                    "level": {"type": "number", "description": "of the line at this test"},
                    "reaches_limit_at": _INSTANT
                    | {"description": "when the line meets the limit; null: it is not known, or not within ten years"},
                    "reaches_limit_earliest": _INSTANT
                    | {"description": "begin of its 95 % interval; null: not known, or not within five years"},
                    "reaches_limit_latest": _INSTANT
                    | {"description": "end of its 95 % interval; null: not known, or not within five years"},
                }
            },
        },
        "steps": {
            "description": "figures whose newest tests lie above or below all before, since the baseline, SI",
            "items": {
                "properties": {
                    "name": {"type": "string"},
                    "before": {"type": "number", "description": "level of the tests before"},
                    "change": {"type": "number", "description": "of the level"},
                    "ci95": {"type": "array", "items": {"type": "number"}, "description": "of change"},
                    "since": {"type": "string", "format": "date-time", "description": "first test after the change"},
                    "tests": {"type": "integer", "description": "tests since then, with this one"},
                }
            },
        },
    }
}


class TrendPointView(BaseModel):
    """One test's value of a figure."""

    test: str
    at: datetime
    value: float
    ci95: tuple[float, float] | None
    label: str | None


class WatchedPointView(BaseModel):
    """One day's value of a figure, read in service: watched, not tested."""

    day: date
    value: float
    ci95: tuple[float, float] | None


class TrendView(BaseModel):
    """One figure over the tests of a valve, SI, and beside them over its days in service."""

    name: str
    meaning: str
    unit: str
    points: list[TrendPointView] = Field(description="of tests, oldest first")
    watched: list[WatchedPointView] = Field(
        description="of days in service, oldest first: a figure like that of the tests, of whatever its loop made the "
        "valve do; no test is held against it"
    )


def trends_of(newest_first: Sequence[PastTest], days: Sequence[WatchedDay]) -> list[TrendView]:
    """Return each figure that any of the tests, or of the days in service (newest first), has."""
    trends = []
    for kind in FIGURE_KINDS.values():
        points = [
            TrendPointView(
                test=test.test_id,
                at=test.at,
                value=test.figures[kind.key].value,
                ci95=test.figures[kind.key].ci95,
                label=test.label,
            )
            for test in reversed(newest_first)
            if kind.key in test.figures
        ]
        watched = [
            WatchedPointView(day=one.day, value=one.figures[kind.key].value, ci95=one.figures[kind.key].ci95)
            for one in reversed(days)
            if kind.key in one.figures
        ]
        if points or watched:
            trends.append(TrendView(name=kind.key, meaning=kind.words, unit=kind.unit, points=points, watched=watched))
    return trends
