"""What the judgement of a result is made of and gives: earlier tests, findings, trends, the state with its reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Final

from service.health.changes import Change, ValveFacts
from service.health.figures import Figures
from service.health.limits import HealthLimits
from service.health.trend import Slope


class Ne107(StrEnum):
    """The states of NAMUR NE 107, the one that is shown first where several apply."""

    FAILURE = "F"
    OUT_OF_SPECIFICATION = "S"
    MAINTENANCE = "M"
    FUNCTION_CHECK = "C"
    NORMAL = "N"


_RANKS: Final = {state: rank for rank, state in enumerate(Ne107)}


@dataclass(frozen=True, slots=True)
class PastTest:
    """An earlier test as its figures are kept."""

    test_id: str
    at: datetime
    figures: Figures
    causes: tuple[str, ...] = ()
    verdict: str = ""
    label: str | None = None
    ne107: str | None = None


@dataclass(frozen=True, slots=True)
class Baseline:
    """The test that later ones are held against, and who chose it; ``set_by`` is empty where nobody did."""

    test: PastTest
    set_by: str = ""
    set_at: datetime | None = None


@dataclass(frozen=True, slots=True)
class Finding:
    """One reason for a state."""

    state: Ne107
    sentence: str


@dataclass(frozen=True, slots=True)
class TrendFound:
    """A figure's slope, and when it meets the limit."""

    name: str
    slope: Slope
    tests: int
    limit_at: datetime | None

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``health.trends``."""
        return {
            "name": self.name,
            "per_day": self.slope.per_day,
            "ci95": list(self.slope.ci95),
            "tests": self.tests,
            "reaches_limit_at": None if self.limit_at is None else self.limit_at.isoformat(),
        }


@dataclass(frozen=True, slots=True)
class Health:
    """How a valve stands by one result: the worst state, every reason, every figure against the baseline."""

    findings: tuple[Finding, ...]
    changes: tuple[Change, ...] = ()
    trends: tuple[TrendFound, ...] = ()
    baseline: Baseline | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def ne107(self) -> Ne107:
        """The worst state that was found; normal where there is nothing."""
        return min((one.state for one in self.findings), key=_RANKS.__getitem__, default=Ne107.NORMAL)

    def to_json(self) -> dict[str, Any]:
        """Return ``analysis.health``."""
        ordered = sorted(self.findings, key=lambda one: _RANKS[one.state])
        base = self.baseline
        return {
            "ne107": self.ne107.value,
            "reasons": [one.sentence for one in ordered] + list(self.notes),
            "changes": [one.to_json() for one in self.changes],
            "trends": [one.to_json() for one in self.trends],
            "baseline": None
            if base is None
            else {"test": base.test.test_id, "at": base.test.at.isoformat(), "set_by": base.set_by or None},
        }


@dataclass(frozen=True, slots=True)
class Case:
    """A result with all that it is judged against.

    ``history`` are earlier tests of the same motion since the baseline, oldest first; ``is_full_stroke`` says that
    nobody narrowed the motion, so that a stem which hardly moves is a failure.
    """

    analysis: Mapping[str, Any]
    at: datetime
    valve: ValveFacts
    limits: HealthLimits
    baseline: Baseline | None = None
    history: tuple[PastTest, ...] = ()
    is_full_stroke: bool = True

    @property
    def is_chosen(self) -> bool:
        """Whether a person chose the baseline: then what it shows is known."""
        return self.baseline is not None and bool(self.baseline.set_by)
