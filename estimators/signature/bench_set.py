"""The bench set: mid-line pressure at 0 and at rated travel."""

from __future__ import annotations

from typing import Final

from estimators.base import MOVED_TOO_LITTLE, absent
from estimators.signature.figures import Bench, figure
from estimators.signature.scatter import Measured
from estimators.signature.span import Span
from valve.messages import say
from valve.nameplate import Nameplate

NO_SPRING: Final = say(
    "no_range_without_spring", "no spring opposes the stem, so the input has no range in which it holds still"
)
_NO_AREA: Final = say("bench_set_needs_area", "a bench set is a pressure: give actuator.diaphragm_area_m2")


def bench_set(nameplate: Nameplate, low: Measured, high: Measured, span: Span | None, *, free: bool = True) -> Bench:
    """Mid-line pressure at 0 and at rated travel, Pa."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if not free or area_m2 is None:
        reason = NO_SPRING if not free else _NO_AREA
        return absent(reason), absent(reason)
    scale = abs(high.value - low.value) / area_m2 if span is None else span.force_n / area_m2
    ends = [figure(one.scaled(1.0 / area_m2), scale=scale, reason=MOVED_TOO_LITTLE) for one in (low, high)]
    missing = next((end for end in ends if end.value is None), None)
    return (ends[0], ends[1]) if missing is None else (missing, missing)
