"""Intervals of fitted values: from the residuals' information, widened by what of them hangs together."""

from __future__ import annotations

import math

import numpy as np

from discrepancy.causes.base import Cause, Fitted
from discrepancy.least_squares import Fit
from discrepancy.significance import noise_factor
from estimators.base import NORMAL_95
from estimators.samples import FloatArray
from valve.effects import EFFECTS


def standard_errors(fit: Fit) -> FloatArray:
    """Return the standard error of each coordinate, shape (p,); infinite where the residuals do not know it."""
    slopes = fit.slopes if fit.slopes is not None else fit.model.slopes(fit.point, fit.residual)
    factor = noise_factor(fit)
    information = slopes @ slopes.T / factor + np.diag(fit.model.unknowns.prior_slopes() ** 2)
    scale = np.sqrt(np.diag(information))
    known = scale > 0.0
    errors = np.full(fit.point.size, math.inf)
    scaled = information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
    values, vectors = np.linalg.eigh(scaled)
    covariance = (vectors / np.maximum(values, 1.0e-14)) @ vectors.T
    errors[known] = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale[known]
    return errors


def fitted_values(fit: Fit, cause: Cause) -> dict[str, Fitted]:
    """Return the parameters of a cause with their 95 % intervals, held within what is physical."""
    errors = dict(zip(fit.model.unknowns.names, standard_errors(fit), strict=True))
    entries = {entry.name: entry for entry in fit.model.unknowns.entries}
    units = {entry.name: entry.unit for entry in EFFECTS[cause.name].parameters}
    found = {}
    for name, unit in units.items():
        own = cause.own(name)
        value = fit.values.get(own)
        if value is None:
            continue
        if own not in entries:
            found[name] = Fitted(value, value, value, unit)
            continue
        entry = entries[own]
        at, half = entry.coordinate(value), NORMAL_95 * float(errors[own])
        lowest, highest = entry.coordinate(entry.lower), entry.coordinate(entry.upper)
        found[name] = Fitted(value, entry.value(max(at - half, lowest)), entry.value(min(at + half, highest)), unit)
    return found
