"""As found beside as left: what a repair changed, each figure with the interval of its change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from service.health.changes import Change, ValveFacts, changes_between
from service.model.health_figures import FIGURE_KINDS
from service.model.health_limits import HealthLimits
from service.model.past_test import PastTest
from service.words.units import UnitSystem, measured

_TOLD_PERCENT: Final = 0.1  # below it a change is sure and matters to nobody: intervals are tighter than that


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two tests of a valve: before a repair, and after it."""

    as_found: PastTest
    as_left: PastTest
    changes: tuple[Change, ...]

    @property
    def sentences(self) -> list[str]:
        """What surely changed, in plain words; one sentence where nothing did."""
        said = [_sentence(one) for one in self.changes if _is_sure(one)]
        cured = [name for name in self.as_found.causes if name not in self.as_left.causes]
        fresh = [name for name in self.as_left.causes if name not in self.as_found.causes]
        said += [f"No longer found: {name.replace('_', ' ')}." for name in cured]
        said += [f"Found only now: {name.replace('_', ' ')}." for name in fresh]
        return said or ["Nothing changed beyond the intervals."]

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as the REST interface shows it."""
        return {
            "as_found": self.as_found.test_id,
            "as_left": self.as_left.test_id,
            "changes": [one.to_json() | {"sure": _is_sure(one)} for one in self.changes],
            "sentences": self.sentences,
        }


def compare(as_found: PastTest, as_left: PastTest, limits: HealthLimits, valve: ValveFacts) -> Comparison:
    """Compare two tests; ``kept`` of each change says whether it is within the valve's limits."""
    return Comparison(as_found, as_left, tuple(changes_between(as_found.figures, as_left.figures, limits, valve)))


def _is_sure(change: Change) -> bool:
    return change.ci95 is not None and not change.ci95[0] <= 0.0 <= change.ci95[1]


def _sentence(change: Change) -> str:
    assert change.change is not None
    assert change.was is not None
    kind = FIGURE_KINDS[change.name]
    way = "rose" if change.change > 0.0 else "fell"
    percent = 0.0 if change.was == 0.0 else 100.0 * abs(change.change / change.was)
    share = f", {percent:.3g} %" if percent >= _TOLD_PERCENT else f", less than {_TOLD_PERCENT:g} %" if percent else ""
    name = kind.words[0].upper() + kind.words[1:]
    moved = measured(abs(change.change), change.size_ci95, kind.unit, UnitSystem.SI)
    return f"{name} {way} by {moved}{share}."
