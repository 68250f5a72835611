"""As found beside as left: what a repair changed, each figure with the interval of its change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from service.health.changes import Change, ValveFacts, changes_between
from service.model.health_figures import FIGURE_KINDS
from service.model.health_limits import HealthLimits
from service.model.past_test import PastTest
from service.words.names import named
from service.words.sentences import as_heading
from service.words.units import measured_said
from valve.messages import say

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
        said += [say("no_longer_found", "No longer found: {cause}.", cause=named(name)) for name in cured]
        said += [say("found_only_now", "Found only now: {cause}.", cause=named(name)) for name in fresh]
        return said or [say("nothing_changed", "Nothing changed beyond the intervals.")]

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
    percent = 0.0 if change.was == 0.0 else 100.0 * abs(change.change / change.was)
    name = as_heading(kind.words)
    moved: str = measured_said(abs(change.change), change.size_ci95, kind.unit)
    if percent >= _TOLD_PERCENT:
        moved = say("by_share", "{moved}, {share:.3g} %", moved=moved, share=percent)
    elif percent:
        moved = say("by_less_than_share", "{moved}, less than {share:g} %", moved=moved, share=_TOLD_PERCENT)
    if change.change > 0.0:
        return say("figure_rose", "{figure} rose by {moved}.", figure=name, moved=moved)
    return say("figure_fell", "{figure} fell by {moved}.", figure=name, moved=moved)
