"""Intervals of fitted values: from the residuals' information, widened by what of them hangs together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.causes.base import Cause, Fitted
from discrepancy.falling_friction import SPEED, as_good_speeds
from discrepancy.least_squares import Fit
from discrepancy.significance import noise_factor
from estimators.base import NORMAL_95
from estimators.samples import BoolArray, FloatArray
from valve.effects import EFFECTS

_JUMP: Final = 0.5  # own choice: the backward slope over the forward one, in size


def standard_errors(fit: Fit) -> FloatArray:
    """Return the standard error of each coordinate, shape (p,); infinite where the residuals do not know it.

    The largest of what the forward slopes say, those without jumps, and the walks along the cost where they were made.
    """
    forward = _slopes(fit)
    return _largest(fit, forward, _of_no_jump(fit, forward))


def with_errors_and_ways(fit: Fit) -> tuple[Fit, FloatArray, FloatArray]:
    """Return the fit with its slopes, its standard errors (p,), and the ways along its valley, shape (p, p).

    By row i of the last each coordinate goes where the one at i goes by 1 and the cost least.
    """
    fit = replace(fit, slopes=_slopes(fit))
    forward = _slopes(fit)
    smooth = _of_no_jump(fit, forward)
    known, scale, values, vectors = _information(fit, smooth)
    covariance = (vectors / values) @ vectors.T / np.outer(scale, scale)
    ways = np.eye(fit.point.size)
    ways[np.ix_(known, known)] = covariance / np.diag(covariance)[:, None]
    return fit, _largest(fit, forward, smooth), ways


def _largest(fit: Fit, forward: FloatArray, smooth: FloatArray) -> FloatArray:
    errors = np.maximum(_errors(fit, forward), _errors(fit, smooth))
    return errors if fit.least_errors is None else np.maximum(errors, fit.least_errors)


def _errors(fit: Fit, slopes: FloatArray) -> FloatArray:
    known, scale, values, vectors = _information(fit, slopes)
    errors = np.full(fit.point.size, math.inf)
    covariance = (vectors / values) @ vectors.T
    errors[known] = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    return errors


def drawn_points(fit: Fit, count: int, seed: int) -> list[FloatArray]:
    """Return points, shape (p,) each, drawn as the errors of a fit scatter about its own, within the bounds.

    Normal with the covariance of slopes without jumps; what the residuals do not know stays.
    """
    known, scale, values, vectors = _information(fit, _of_no_jump(fit, _slopes(fit)))
    unknowns, generator = fit.model.unknowns, np.random.default_rng(seed)
    points = []
    for _ in range(count):
        point = fit.point.copy()
        point[known] += vectors @ (generator.standard_normal(values.size) / np.sqrt(values)) / scale
        points.append(np.asarray(np.clip(point, unknowns.lower, unknowns.upper), np.float64))
    return points


def _slopes(fit: Fit) -> FloatArray:
    return fit.slopes if fit.slopes is not None else fit.model.slopes(fit.point, fit.residual)


def _of_no_jump(fit: Fit, forward: FloatArray) -> FloatArray:
    """Return the ``forward`` slopes, with the backward one to each coordinate where it is far smaller, (p, count).

    A slip that comes or goes within a step moves the stem by far more than the step is worth: such a quotient says that
    the coordinate is known a thousand times as well as it is. Where both are alike none is exchanged: what tells two
    coordinates apart is a small difference of their slopes, which must be of one kind.
    """
    backward = fit.model.slopes(fit.point, fit.residual, is_backward=True)
    before, after = np.linalg.norm(backward, axis=1), np.linalg.norm(forward, axis=1)
    # none is 0 unless the stem could not be followed there
    is_smaller = (before > 0.0) & ((before < _JUMP * after) | (after == 0.0))
    return np.where(is_smaller[:, None], backward, forward)


def _information(fit: Fit, slopes: FloatArray) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
    """Return which coordinates are known, (p,), their scale, and the information's eigenvalues and vectors in it."""
    information = slopes @ slopes.T / noise_factor(fit) + np.diag(fit.model.unknowns.prior_slopes() ** 2)
    size = np.sqrt(np.diag(information))
    known = size > 0.0
    scaled = information[np.ix_(known, known)] / np.outer(size[known], size[known])
    values, vectors = np.linalg.eigh(scaled)
    return known, size[known], np.maximum(values, 1.0e-14), vectors


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
        ends = entry.value(max(at - half, lowest)), entry.value(min(at + half, highest))
        as_good = as_good_speeds(fit) if own == SPEED else None
        low, high = ends if as_good is None else (min(ends[0], as_good[0]), max(ends[1], as_good[1]))
        found[name] = Fitted(value, low, high, unit)
    return found


def may_be_nothing(cause: Cause, parameters: Mapping[str, Fitted]) -> bool:
    """Whether the interval of a cause's strength holds the value at which it does nothing."""
    strength = parameters.get(cause.strength)
    return strength is not None and cause.neutral is not None and strength.low <= cause.neutral <= strength.high
