"""Resolution and dead band from steps: the least change that moved the stem and the greatest that did not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from estimators.steps.answer import StepAnswer
from valve.messages import Message, say

_HIDDEN_SIGMAS: Final = 3.0  # by which a motion that was called none may have been larger


@dataclass(frozen=True, slots=True)
class Bracket:
    """The least input change that moved the stem and the greatest below it that did not, percent of span."""

    moved_percent: float | None
    unmoved_percent: float

    def to_json(self, name: Message) -> dict[str, Any]:
        """Return value, interval and the reason where there is none."""
        if self.moved_percent is None:
            tried = (
                say("step_of_percent", "{percent:.3g} %", percent=self.unmoved_percent)
                if self.unmoved_percent > 0.0
                else say("none", "none")
            )
            unmoved = say("no_step_moved", "no {step} moved the stem (largest tried: {tried})", step=name, tried=tried)
            return {"value": None, "ci95": None, "note": unmoved}
        note = (
            ""
            if self.unmoved_percent > 0.0
            else say(
                "every_step_moved",
                "every {step} moved the stem: smaller ones were not tried, or noise hides them",
                step=name,
            )
        )
        return {"value": self.moved_percent, "ci95": [self.unmoved_percent, self.moved_percent], "note": note}


def resolution(answers: list[StepAnswer], span: float, travel_m: float) -> tuple[Bracket, Bracket]:
    """Resolution and dead band from the steps, percent of span.

    Steps add up until the stem moves, so what counts is the input's change since it last moved: in the direction
    of that motion for the resolution, against it for the dead band. Karnopp's stem, if damped, comes to rest with
    F - k x - F_0 = A = F_c + F_v DV: the resolution is (F_s - A)/(S_a span), the dead band (F_s + A)/(S_a span).
    A step that moved nothing beyond noise may have moved the stem by that: so much less is what surely did not.
    """
    onward: list[tuple[float, bool]] = []
    back: list[tuple[float, bool]] = []
    heading, since = 0.0, 0.0
    for one in answers:
        since += one.step.size
        if heading != 0.0 and since != 0.0:
            unseen = 0.0 if one.moved else 100.0 * (abs(one.change_m) + _HIDDEN_SIGMAS * one.level_error_m) / travel_m
            tried = max(0.0, 100.0 * abs(since) / span - unseen)
            (onward if since * heading > 0.0 else back).append((tried, one.moved))
        if one.moved:
            heading, since = math.copysign(1.0, one.change_m), 0.0
    return _bracket(onward), _bracket(back)


def _bracket(tried: list[tuple[float, bool]]) -> Bracket:
    moved = [size for size, motion in tried if motion]
    least = min(moved) if moved else None
    unmoved = [size for size, motion in tried if not motion and (least is None or size < least)]
    return Bracket(least, max(unmoved, default=0.0))
