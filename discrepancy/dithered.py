"""A stem that a periodic force moves to and fro: it is fitted on its first rests, where each motion stands for itself.

The forces at the breakaways tell frequency, phase, spring and preload nearly, and of friction in motion nothing. On the
whole record thousands of motions have to be right at once, and a step costs as much as the record is long; on the
first of them, each begun anew at its measured rest, friction and the force find their places from far away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final

from discrepancy.causes.base import Cause
from discrepancy.growing import first_part
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.significance import misfit

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_RESTS: Final = 40  # of the first part
_SHORT: Final = 3  # times as many in all, from which on that is much shorter than the record
_DROPS: Final = (0.0, 0.1, 0.25)  # F_s over F_c, less 1
_DAMPINGS: Final = (0.1, 0.3, 1.0, 3.0)  # shares of the critical one
_FOLLOWED: Final = 2
_STEPS: Final = 12
_GROWING_STEPS: Final = 6
_GROWTH: Final = 4.0  # of a part to the next
_PROMISING: Final = 100.0  # misfit of the first part, above which what began it is not followed
HELD: Final = frozenset({"m", "k", "F_0", "DV", "first_rise", "delay_s"})


def from_first_rests(starts: Sequence[Fit], cause: Cause) -> Fit | None:
    """Return the fit of the whole that one of these starts leads to from the first rests on; None where none does.

    Each start has a periodic force, spring, preload and static friction; friction in motion begins anew. A multiple of
    the frequency tells the forces at the breakaways as well, and no motion. None also where the record has hardly more
    rests than its first part. What another cause does later is left for that.
    """
    until_s = first_rests_until_s(starts[0].model) if starts else None
    if until_s is None:
        return None
    held = HELD | {cause.own("frequency_hz")}
    best = min((_begun(part_until(one.model, until_s), one, held) for one in starts), key=lambda one: one.cost)
    return grown_from(best, starts[0].model, until_s) if misfit(best) < _PROMISING else None


def first_rests_until_s(model: Model) -> float | None:
    """Return when the first rests of the only record end, s; None where they are not much shorter than the record."""
    segments = model.observed.segments
    if len(segments) != 1 or segments[0].rest_time_s.size < _SHORT * _RESTS:
        return None
    return float(segments[0].rest_time_s[_RESTS])


def _begun(part: Model, start: Fit, held: frozenset[str]) -> Fit:
    """Return the lowest fit of the first part, with all that its slips do not tell as in the start."""
    values = start.values
    static_n = values["F_c"] * (1.0 + values["d"])
    critical = 2.0 * math.sqrt(values["k"] * values["m"])
    tried = []
    for drop, damping in product(_DROPS, _DAMPINGS):
        slips = {"F_c": static_n / (1.0 + drop), "d": drop, "F_v": damping * critical}
        tried.append(start_fit(part, part.unknowns.point({**values, **slips})))
    tried.sort(key=lambda one: one.cost)
    return min((descend(one, most_steps=_STEPS, held=held) for one in tried[:_FOLLOWED]), key=lambda one: one.cost)


def grown_from(fit: Fit, whole: Model, until_s: float) -> Fit | None:
    """Return the fit of the whole that a fit of the first part leads to, through parts that are longer each."""
    segment = whole.observed.segments[0]
    begin_s, end_s = float(segment.time_s[0]), float(segment.time_s[-1])
    while fit.model is not whole:
        until_s = begin_s + _GROWTH * (until_s - begin_s)
        fit = start_fit(whole if until_s >= end_s else part_until(whole, until_s), fit.point)
        fit = descend(fit, most_steps=_GROWING_STEPS)
        if not fit.is_followed:
            return None
    return fit


def part_until(model: Model, until_s: float) -> Model:
    """Return the model of what comes before a time, s, of the only record."""
    segment = model.observed.segments[0]
    return replace(model, observed=model.observed.of([first_part(segment, until_s)]), thin=None)
