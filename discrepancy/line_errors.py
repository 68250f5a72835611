"""The errors of the measured force in the residuals: a line's end that is off by a little moves thousands of rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
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
    spread = _spread(model, fit.point)
    thin = model.thin
    if thin is not None:
        thin = replace(thin, spread=_spread(model.thinned(), fit.point))
    model = replace(model, observed=replace(model.observed, spread=spread), thin=thin)
    return descend(start_fit(model, fit.point), most_steps=_STEPS)


def _spread(model: Model, point: FloatArray) -> FloatArray | None:
    """Return what the errors do to the residuals at a point, shape (count, d), as ``Observed.residuals`` takes it."""
    observed = replace(model.observed, spread=None)
    plain = replace(model, observed=observed)
    here = plain.residuals(point)
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
    if not columns:
        return None
    directions, sizes, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return np.asarray(directions * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + sizes * sizes)))
