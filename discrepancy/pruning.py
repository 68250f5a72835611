"""Causes that a choice can do without once all have found their places: each is left out, and the rest fitted again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.baseline import scanned
from discrepancy.causes.base import Cause
from discrepancy.finishing import finished
from discrepancy.intervals import fitted_values, may_be_nothing
from discrepancy.law_forms import has_free_form
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.refining import refined
from discrepancy.screening import extended_model, held_of
from discrepancy.setting import setting_of
from discrepancy.significance import is_significant, misfit

_PRUNING_STEPS: Final = 15
_LOOK_CLOSER: Final = 2.0  # times the misfit of all causes: one may be needless
_FADING: Final = (0.7, 0.5, 0.4, 0.2)  # of a strength, one after the other: to 3 % of it
_FADING_STEPS: Final = 6
_LIMITS: Final = np.log([0.25, 0.4, 0.6, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 8.0])  # times DV


def pruned(baseline: Fit, best: Fit, chosen: list[Cause], *, fades: bool = False) -> tuple[Fit, list[Cause]]:
    """Drop the causes without which the rest does as well, once it has found its place.

    ``fades``: each is led to nothing step by step before it is kept, and not only what cannot be told from nothing.
    """
    for cause in list(chosen):
        others = [other for other in chosen if other is not cause]
        fit = with_causes(baseline, best, others)
        is_far = fit.is_followed and misfit(fit) >= _LOOK_CLOSER * misfit(best)
        if is_far and (fades or may_be_nothing(cause, fitted_values(best, cause))):
            # what cannot be told from nothing is needless, however far the rest has to go without it
            fit = with_causes(baseline, _faded(best, cause), others)
        if is_far:
            fit = min(fit, _with_another_limit(with_causes(baseline, best, others, most_steps=0)), key=_cost)
        if fit.is_followed and not is_significant(fit, best) and misfit(fit) < _LOOK_CLOSER * misfit(best):
            best, chosen = fit, others
        elif fit.is_followed and misfit(fit) < _LOOK_CLOSER * misfit(best):
            # a cause that only helped a fit down from an edge is none
            fit = refined(finished(fit))
            if not is_significant(fit, best):
                best, chosen = fit, others
    return best, chosen


def _with_another_limit(fit: Fit) -> Fit:
    """Return the fit with the DV that costs least, descended: a wide one stands for what falls with speed."""
    return descend(scanned(fit, "DV", _LIMITS), most_steps=_PRUNING_STEPS)


def _cost(fit: Fit) -> float:
    return fit.cost if fit.is_followed else math.inf


def with_causes(baseline: Fit, fit: Fit, causes: list[Cause], most_steps: int = _PRUNING_STEPS) -> Fit:
    """Return the fit with these causes and no others, descended from where ``fit`` has them."""
    model, setting = baseline.model, setting_of(fit)
    for cause in causes:
        model = extended_model(model, cause, setting, is_free=has_free_form(fit, cause))
    model = replace(model, held={**model.held, **held_of(fit, causes)})
    return descend(start_fit(model, model.unknowns.point(fit.values)), most_steps=most_steps)


def _faded(fit: Fit, cause: Cause) -> Fit:
    """Return the fit with the strength of a cause led to next to nothing, step by step, and the others following."""
    unknowns, name = fit.model.unknowns, cause.own(cause.strength)
    place = unknowns.names.index(name)
    held = frozenset(one for one in unknowns.names if one.startswith(cause.own("")))
    for share in _FADING:
        point = fit.point.copy()
        point[place] *= share
        fit = descend(start_fit(fit.model, point), most_steps=_FADING_STEPS, held=held)
    return fit
