"""What the judgement of a result is made of and gives: earlier tests, findings, trends, steps, state and reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Final

from service.health.changes import Change, ValveFacts
from service.health.step import Step
from service.health.trend import Crossing, Slope
from service.model.health_limits import HealthLimits
from service.model.past_test import Baseline, PastTest


class Ne107(StrEnum):
    """The states of NAMUR NE 107, the one that is shown first where several apply."""

    FAILURE = "F"
    OUT_OF_SPECIFICATION = "S"
    MAINTENANCE = "M"
    FUNCTION_CHECK = "C"
    NORMAL = "N"


_RANKS: Final = {state: rank for rank, state in enumerate(Ne107)}


@dataclass(frozen=True, slots=True)
class Finding:
    """One reason for a state; ``effect_percent`` is what it does to the stem, of rated travel, None where unknown."""

    state: Ne107
    sentence: str
    effect_percent: float | None = None


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that is asked of a valve from its first test on.

    ``met`` is None where the result cannot say. ``state`` and ``sentence`` are what holds where it is not met.
    ``is_widened`` says that ``limit`` has what the baseline shows that a person chose. ``open_because`` says why a
    check that somebody asked for was not made.
    """

    name: str
    words: str
    unit: str
    value: float | None
    limit: float
    met: bool | None
    state: Ne107
    sentence: str
    effect_percent: float | None = None
    is_widened: bool = False
    open_because: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``health.acceptance.checks``."""
        return {
            "name": self.name,
            "meaning": self.words,
            "unit": self.unit,
            "value": self.value,
            "limit": self.limit,
            "met": self.met,
            "note": self.open_because,
        }


@dataclass(frozen=True, slots=True)
class TrendFound:
    """A figure's slope, when it meets the limit, and the share of the allowed change that its line has used."""

    name: str
    slope: Slope
    crossing: Crossing | None
    share_used: float = 0.0

    @property
    def limit_at(self) -> datetime | None:
        """When the line meets the limit."""
        return None if self.crossing is None else self.crossing.at

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``health.trends``."""
        met = self.crossing
        return {
            "name": self.name,
            "per_day": self.slope.per_day,
            "ci95": list(self.slope.ci95),
            "tests": self.slope.tests,
            "level": self.slope.last,
            "reaches_limit_at": None if met is None else met.at.isoformat(),
            "reaches_limit_earliest": None if met is None or met.earliest is None else met.earliest.isoformat(),
            "reaches_limit_latest": None if met is None or met.latest is None else met.latest.isoformat(),
        }


@dataclass(frozen=True, slots=True)
class StepFound:
    """A figure whose newest tests lie above or below all before; ``limit`` is the change against the baseline."""

    name: str
    step: Step
    limit: float

    @property
    def size_ci95(self) -> tuple[float, float]:
        """Interval of the step's size, whichever way it went."""
        low, high = sorted(abs(end) for end in self.step.ci95)
        return low, high

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``health.steps``."""
        return {
            "name": self.name,
            "before": self.step.before,
            "change": self.step.change,
            "ci95": list(self.step.ci95),
            "since": self.step.since.isoformat(),
            "tests": self.step.tests,
        }


@dataclass(frozen=True, slots=True)
class Health:
    """How a valve stands by one result: the worst state, every reason, every figure against the baseline.

    ``remarks`` names the causes that were seen and do not matter yet.
    ``is_accepted`` says that nothing stands against the valve by this result alone: then it may become the baseline.
    """

    findings: tuple[Finding, ...]
    changes: tuple[Change, ...] = ()
    trends: tuple[TrendFound, ...] = ()
    baseline: Baseline | None = None
    notes: tuple[str, ...] = field(default=())
    checks: tuple[Check, ...] = ()
    remarks: tuple[str, ...] = ()
    is_accepted: bool = False
    steps: tuple[StepFound, ...] = ()

    @property
    def effect_percent(self) -> float | None:
        """What the findings do to the stem, the largest, percent of rated travel; None where nothing is known."""
        return max((one.effect_percent for one in self.findings if one.effect_percent is not None), default=None)

    @property
    def ne107(self) -> Ne107:
        """The worst state that was found; normal where there is nothing."""
        return min((one.state for one in self.findings), key=_RANKS.__getitem__, default=Ne107.NORMAL)

    def to_json(self) -> dict[str, Any]:
        """Return ``analysis.health``."""
        ordered = sorted(self.findings, key=lambda one: (_RANKS[one.state], -(one.effect_percent or 0.0)))
        base = self.baseline
        return {
            "ne107": self.ne107.value,
            "reasons": [one.sentence for one in ordered] + list(self.notes),
            "effect_percent_of_span": self.effect_percent,
            "remarks": list(self.remarks),
            "acceptance": {"passed": self.is_accepted, "checks": [one.to_json() for one in self.checks]},
            "changes": [one.to_json() for one in self.changes],
            "trends": [one.to_json() for one in self.trends],
            "steps": [one.to_json() for one in self.steps],
            "baseline": None
            if base is None
            else {"test": base.test.test_id, "at": base.test.at.isoformat(), "set_by": base.set_by or None},
        }


@dataclass(frozen=True, slots=True)
class Case:
    """A result with all that it is judged against.

    ``history`` are earlier tests of the same motion since the baseline, oldest first; ``is_full_stroke`` says that
    nobody narrowed the motion, so that a stem which hardly moves is a failure. ``out_of_family`` is the breakaway that
    ended the test (``service.model.family_rule``).
    """

    analysis: Mapping[str, Any]
    at: datetime
    valve: ValveFacts
    limits: HealthLimits
    baseline: Baseline | None = None
    history: tuple[PastTest, ...] = ()
    is_full_stroke: bool = True
    out_of_family: Mapping[str, Any] | None = None

    @property
    def is_chosen(self) -> bool:
        """Whether a person chose the baseline: then what it shows is known."""
        return self.baseline is not None and bool(self.baseline.set_by)
