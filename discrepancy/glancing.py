"""A short look at a cause beside a plain valve that leaves noise alone: most are not worth more."""

from __future__ import annotations

from itertools import islice
from typing import Final

from discrepancy.causes.base import Setting
from discrepancy.causes.friction import STRIBECK
from discrepancy.falling_friction import from_first_slips, from_wide_limit, may_ring
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.periodic import has_place
from discrepancy.screening import Candidate, distinct, extended_model, point_of
from discrepancy.significance import is_significant

_STEPS: Final = 3


def glance(fit: Fit, candidate: Candidate, setting: Setting) -> Fit:
    """Return a short fit with this cause from its best start, for a misfit that noise may well explain.

    Where the plain valve explains a falling friction by a wide DV or next to no damping, no start of a grid is as near
    as these are. A periodic force begins at its likeliest line, too, whatever that costs as it stands.
    """
    model = extended_model(fit.model, candidate.cause, setting)
    starts = [start_fit(model, point_of(fit, model, candidate.cause, start)) for start in distinct(candidate.starts)]
    if candidate.cause is STRIBECK and may_ring(fit, setting):
        for begin in (from_wide_limit, from_first_slips):
            own = begin(fit, model, setting)
            starts += [] if own is None else [own]
            if own is not None and is_significant(fit, own):
                break
    found = descend(min(starts, key=lambda one: one.cost), most_steps=_STEPS)
    if not candidate.cause.is_periodic:
        return found
    # rests hold against a small force, so that one linear step overshoots: the cost at its end says nothing
    lines = (start for start in candidate.starts if not has_place(start, fit.values))
    likeliest = [start_fit(model, point_of(fit, model, candidate.cause, start)) for start in islice(lines, 1)]
    led = [descend(one, most_steps=_STEPS) for one in likeliest]
    return min([found, *led], key=lambda one: one.cost)
