"""A stick-slip followed through the rests that it comes to by itself, and no longer begun anew at the measured ones.

Begun anew, a stem that is out of phase with the measured one finds its way back: a search needs that. Yet a rest is
measured no better than its rows' mean, and what a slow sensor or a creep adds to that moves the next slip as a whole:
of a valve that is right all through, the measured rests are what hangs together in the residuals. What comes lower
without them is nearer to the valve.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed
from discrepancy.significance import is_noise
from discrepancy.sills import over_sills

_STEPS: Final = 20
_NONE: Final = np.empty(0)


def running_on(fit: Fit) -> Fit:
    """Return the fit with a stem that runs on through all its rests where that costs less; the fit itself elsewhere."""
    if not fit.is_followed or is_noise(fit) or not any(one.rest_m.size for one in fit.model.observed.segments):
        return fit
    free = followed_freely(fit)
    return free if free.cost < fit.cost else fit


def followed_freely(fit: Fit) -> Fit:
    """Return the fit with a stem that runs on through all its rests, at its lowest."""
    return over_sills(start_fit(_without_rests(fit.model), fit.point), most_steps=_STEPS)


def _without_rests(model: Model) -> Model:
    thin = None if model.thin is None else _running(model.thin)
    return replace(model, observed=_running(model.observed), thin=thin)


def _running(observed: Observed) -> Observed:
    segments = [replace(one, rest_time_s=_NONE, rest_m=_NONE, rest_sense=_NONE) for one in observed.segments]
    return replace(observed, segments=tuple(segments))
