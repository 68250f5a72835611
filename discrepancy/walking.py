"""A walk along a bent valley of the cost: step by step, until it leads hardly lower."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Final

from discrepancy.least_squares import Fit

_MISSES: Final = 2  # steps that lead hardly lower, in a row, after which a walk ends


def walked(
    fit: Fit,
    step: Callable[[Fit], Fit | None],
    *,
    worth: float = 1.0,
    enough: float = 0.0,
    most_steps: int | None = None,
) -> Fit:
    """Return the lowest fit on a walk of which ``step`` makes each fit from the one before it.

    A step is worth another where it comes below the share ``worth`` of the lowest cost. The walk ends after two that
    are not, where a step gives no motion, at ``most_steps``, and at ``enough`` times the cost of noise; and where the
    work of a diagnosis is done.
    """
    best, here, misses = fit, fit, 0
    for number in count():
        if misses == _MISSES or number == most_steps or fit.model.tally.is_spent:
            break
        if best.cost < enough * fit.model.observed.count:
            break
        following = step(here)
        if following is None or not following.is_followed:
            break
        here = following
        misses = 0 if here.cost < worth * best.cost else misses + 1
        best = here if here.cost < best.cost else best
    return best
