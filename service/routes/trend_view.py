"""Figures over tests as the REST interface shows them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from pydantic import BaseModel, Field

from service.model.health_figures import FIGURE_KINDS
from service.model.past_test import PastTest


class TrendPointView(BaseModel):
    """One test's value of a figure."""

    test: str
    at: datetime
    value: float
    ci95: tuple[float, float] | None
    label: str | None


class TrendView(BaseModel):
    """One figure over the tests of a valve, SI."""

    name: str
    meaning: str
    unit: str
    points: list[TrendPointView] = Field(description="oldest first")


def trends_of_tests(newest_first: Sequence[PastTest]) -> list[TrendView]:
    """Return each figure that any of the tests has."""
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
        if points:
            trends.append(TrendView(name=kind.key, meaning=kind.words, unit=kind.unit, points=points))
    return trends
