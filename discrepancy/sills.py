"""Descents over the sills of a stick-slip: the rest whose end hangs on the last digit is left out for some steps.

A crest of the force, or the first ramp, lets a stem go or not, and the misfit of that one slip jumps by more than all
others are worth. A fit that comes to such an edge stays there: no difference quotient across it says where the rest of
the record leads. Without that rest's rows it does, and with them again the fit is as good or is not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.least_squares import Fit, descend, start_fit
from estimators.samples import BoolArray, IntArray

# Own choices, from valves with a hidden effect (docs/diagnosis.md).
_JUMP: Final = 30.0  # times the smaller of the forward and backward slopes, that the larger is
_MOST_SHARE: Final = 0.2  # of the rests
_LEFT: Final = 1.0e-6  # of their weight
_TURNS: Final = 6
_LOWER: Final = 0.5  # of the cost, that another turn is worth


def over_sills(fit: Fit, *, most_steps: int, held: frozenset[str] = frozenset()) -> Fit:
    """Return the fit descended until that leads hardly lower; where an edge ends it, also without its rests."""
    best = descend(fit, most_steps=most_steps, held=held)
    for _ in range(_TURNS):
        there = descend(_begun_beside(best, most_steps, held), most_steps=most_steps, held=held)
        if not there.cost < best.cost - _LOWER:
            break
        best = there
    return best


def _begun_beside(fit: Fit, most_steps: int, held: frozenset[str]) -> Fit:
    """Return where the rests that do not hang on an edge lead; the fit itself where none does."""
    edged, model = edged_blocks(fit), fit.model
    if not edged.any():
        return fit
    segments, first = [], 0
    for segment in model.observed.segments:
        own = np.where(edged[first : first + segment.time_s.size], _LEFT, 1.0)
        segments.append(replace(segment, weight=segment.weight * own))
        first += segment.time_s.size
    without = replace(model, observed=replace(model.observed, segments=tuple(segments)), thin=None)
    return start_fit(model, descend(start_fit(without, fit.point), most_steps=most_steps, held=held).point)


def rest_edges(fit: Fit) -> IntArray:
    """Return the first block after each measured rest, and of each segment, shape (r,)."""
    first, found = 0, []
    for segment in fit.model.observed.segments:
        found += [first, *(first + np.searchsorted(segment.time_s, segment.rest_time_s))]
        first += segment.time_s.size
    kept = np.unique(found)
    return np.asarray(kept[kept < first], np.int64)


def edged_blocks(fit: Fit) -> BoolArray:
    """Return where a block is of a rest that a step one way changes far more than one the other way, shape (n,)."""
    none = np.zeros(fit.residual.size, dtype=bool)
    edges = rest_edges(fit)
    if edges.size < 2 or not fit.is_followed:
        return none
    ways = (fit.model.slopes(fit.point, fit.residual, is_backward=backward) for backward in (False, True))
    size = [np.sqrt(np.add.reduceat(slopes**2, edges, axis=1)) for slopes in ways]
    smaller, larger = np.minimum(*size), np.maximum(*size)
    # beside the same coordinate's slope in the other rests: where it says nothing, a ratio says nothing either
    least = 1.0e-3 * np.median(larger, axis=1, keepdims=True)
    jumps = ((larger > _JUMP * np.maximum(smaller, least)) & (larger > 0.0)).any(axis=0)
    if not 0 < np.count_nonzero(jumps) <= max(1.0, _MOST_SHARE * edges.size):
        return none
    return np.repeat(jumps, np.diff(np.append(edges, fit.residual.size)))
