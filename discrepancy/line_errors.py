"""The errors of the measured force in the residuals: a line's end that is off by a little moves thousands of rows."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed
from estimators.samples import FloatArray

# Own choices: directions whose one sigma moves all positions together by less do not matter.
_LEAST_EFFECT: Final = 0.05
_STEPS: Final = 6


def with_line_errors(fit: Fit) -> Fit:
    """Return the fit with the errors of the measured force's lines counted as noise; as it is where they are nothing.

    A noisy pressure is read as straight lines, and the noise leaves a level and a slope of each unknown. Their effect
    is taken at the fit's point and eliminated linearly, with the size that the noise gives them.
    """
    model = fit.model
    if not (fit.is_followed and model.observed.deviations):
        return fit
    thin = model.thin
    if thin is not None:
        thin = _with_spread(model.thinned(), fit.point)
    model = replace(model, observed=_with_spread(model, fit.point), thin=thin)
    return descend(start_fit(model, fit.point), most_steps=_STEPS)


def _with_spread(model: Model, point: FloatArray) -> Observed:
    """Return a model's recordings with what the errors do to the residuals at a point.

    What no deviation holds moves a row by the share of the variance that it has beside these: in noises of one row, and
    of the median block, for a stem that rests is moved all along by what one turn of the force was off.
    """
    observed = replace(model.observed, spread=None)
    effect = _effect(replace(model, observed=observed), point)
    if effect is None:
        return replace(observed, unresolved_rms=0.0)
    rows = np.concatenate([segment.rows for segment in observed.segments])
    rms = math.sqrt(observed.unresolved * float(np.median(np.square(effect).sum(axis=1) / rows)))
    directions, sizes, _ = np.linalg.svd(effect, full_matrices=False)
    spread = np.asarray(directions * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + sizes * sizes)))
    return replace(observed, spread=spread, unresolved_rms=rms)


def _effect(plain: Model, point: FloatArray) -> FloatArray | None:
    """Return what one sigma along each deviation does to the residuals, shape (count, d); None where nothing."""
    observed, here = plain.observed, plain.residuals(point)
    if here is None:
        return None
    columns = []
    for changed in observed.deviations:
        segments = tuple(
            replace(segment, corner_s=corner_s, corner_n=corner_n)
            for segment, (corner_s, corner_n) in zip(observed.segments, changed, strict=True)
        )
        there = replace(plain, observed=replace(observed, segments=segments)).residuals(point)
        if there is not None and float(np.linalg.norm(there - here)) > _LEAST_EFFECT:
            columns.append(there - here)
    return np.stack(columns, axis=1) if columns else None
