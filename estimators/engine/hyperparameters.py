"""How rough friction is, by the motion itself: the hyperparameters that maximise the marginal likelihood of a fit.

At the end of a fit the model is linear in the fields' values w, with -w'Gw/2 + h'w as the logarithm of their likelihood
once all other unknowns are integrated out. With the prior's precision Q the marginal likelihood is then
-2 ln L = ln|G + Q| - ln|Q| - h'(G + Q)^-1 h (restricted maximum likelihood). The balance of forces, whose blocks
are means over the travel, sees neither how smooth the friction is nor what the stem met in its jumps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from estimators.engine.fields import Fields, fields_on, wander_precision
from estimators.engine.roughness import (
    ROUGH,
    SMOOTH,
    Roughness,
    RoughnessPrior,
    roughness_of,
    travel_correlation,
)
from estimators.linear_fit import inverse_of

FloatArray = npt.NDArray[np.float64]

_LAWS: Final = 5  # logarithms of common, own, length, wander and its time
_SEARCH: Final = {"maxiter": 12, "ftol": 1.0e-5}
_HESSIAN_STEP: Final = 0.05
_OUTER: Final = math.sqrt(3.0)  # standard deviations from the middle to the outer points
_MOST_WEIGHT: Final = 5.0  # times that of a normal distribution
_STEP: Final = 1.0e-3  # of a logarithm


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations of all unknowns without the fields' prior; ``part`` are the fields, with these ``values``."""

    normal: FloatArray
    right: FloatArray
    part: slice
    values: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Factor:
    """Cholesky's factor of a matrix scaled to a diagonal of one: its units differ by ten orders."""

    lower: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, matrix: FloatArray) -> _Factor | None:
        """Return it, None where the matrix is not positive definite as far as numbers go."""
        diagonal = np.diag(matrix)
        if not (np.all(diagonal > 0.0) and np.isfinite(matrix).all()):
            return None
        scale = 1.0 / np.sqrt(diagonal)
        scaled = matrix * np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += 1.0e-12
        try:
            return cls(cho_factor(scaled, lower=True, check_finite=False)[0], scale)
        except LinAlgError:
            return None

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution for right sides in columns."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return np.asarray(scale * cho_solve((self.lower, True), scale * right, check_finite=False))

    def inverse(self) -> FloatArray:
        """Return the matrix's inverse."""
        return inverse_of(self.lower) * np.outer(self.scale, self.scale)

    @property
    def log_determinant(self) -> float:
        return 2.0 * float(np.log(np.diag(self.lower)).sum() - np.log(self.scale).sum())


@dataclass(frozen=True, slots=True, eq=False)
class FieldLikelihood:
    """What a recording says of the fields' values, all else integrated out: G, shape (f, f), and h, shape (f,).

    Linear functions of the unknowns (q of them) are ``of_fields`` times the values, shape (q, f), and what does not
    depend on these; ``others`` is its variance, shape (q,).
    """

    information: FloatArray
    pull: FloatArray
    of_fields: FloatArray
    others: FloatArray


def field_likelihood(equations: Equations, functions: FloatArray | None = None) -> FieldLikelihood | None:
    """Return it, with linear functions of the unknowns; None where others are not determined.

    ``functions``: shape (q, n_unknowns), SI.
    """
    normal, right, part, values = equations.normal, equations.right, equations.part, equations.values
    functions = np.zeros((0, right.size)) if functions is None else functions
    others = np.ones(right.size, bool)
    others[part] = False
    factor = _Factor.of(normal[np.ix_(others, others)])
    if factor is None:
        return None
    cross, own = normal[others, part], functions[:, others].T
    solved = factor.solve(np.column_stack([cross, right[others], own]))
    of_others, count = solved[:, values.size + 1 :], values.size
    information = normal[part, part] - cross.T @ solved[:, :count]
    information = 0.5 * (information + information.T)
    return FieldLikelihood(
        information,
        right[part] - cross.T @ solved[:, count] + information @ values,
        functions[:, part] - of_others.T @ cross,
        np.asarray(np.sum(own * of_others, axis=0)),
    )


def refined(
    fields: Fields, likelihood: FieldLikelihood, prior: RoughnessPrior, kinds: tuple[int, ...] = (ROUGH, SMOOTH)
) -> Fields:
    """Return the fields with the likeliest hyperparameters and smoothness, begun at those that they have."""
    assert fields.roughness is not None
    start = np.clip(fields.roughness.logarithms(), prior.low, prior.high)[:_LAWS]
    best: tuple[float, FloatArray, int] | None = None
    for smoothness in kinds:

        def of_fields(at: FloatArray, smoothness: int = smoothness) -> tuple[float, FloatArray]:
            return surprise(fields, likelihood, at, smoothness)

        least, likeliest = prior.lowest(of_fields, start, _SEARCH)
        if math.isfinite(least) and (best is None or least < best[0]):
            best = least, likeliest, smoothness
    if best is None:
        return fields
    return fields_on(fields.travel_m, fields.time_s, _roughness(best[1]), best[2])


def spread(fields: Fields, likelihood: FieldLikelihood, prior: RoughnessPrior) -> tuple[FloatArray, FloatArray] | None:
    """Shifts and variances of the linear functions where the roughness is as uncertain as the recording leaves it.

    None where the recording leaves nothing to tell it by.

    Gauss and Hermite's three points on each axis of the hyperparameters' posterior, weighed by the posterior itself
    (Rue, Martino and Chopin, 2009); shape (q,) each.
    """
    assert fields.roughness is not None
    middle = np.clip(fields.roughness.logarithms(), prior.low, prior.high)[:_LAWS]

    def posterior(at: FloatArray) -> tuple[float, FloatArray]:
        value, slope = surprise(fields, likelihood, at, fields.smoothness)
        squares, prior_slope = prior.squares(at)
        return value + 0.5 * squares, slope + prior_slope

    hessian = np.array(
        [
            (posterior(middle + unit)[1] - posterior(middle - unit)[1]) / (2.0 * _HESSIAN_STEP)
            for unit in _HESSIAN_STEP * np.eye(_LAWS)
        ]
    )
    found = _given(fields, likelihood, middle, prior)
    if found is None or not np.all(np.isfinite(hessian)):
        return None
    known = prior.spread[:_LAWS]
    # nowhere wider than what is known beforehand
    sizes, axes = np.linalg.eigh(0.5 * (hessian + hessian.T) * np.outer(known, known))
    axes = known[:, None] * axes / np.sqrt(np.maximum(sizes, 1.0))
    values, first, best = found
    shift, variance = np.zeros(values.size), first.copy()
    for axis in axes.T:
        means, variances, weights = [values], [first], [2.0 / 3.0]
        for sign in (1.0, -1.0):
            at = np.clip(middle + sign * _OUTER * axis, prior.low[:_LAWS], prior.high[:_LAWS])
            outer = _given(fields, likelihood, at, prior)
            if outer is None:
                continue
            value, one, there = outer
            density = math.exp(min(best - there + 0.5 * _OUTER**2, math.log(_MOST_WEIGHT)))
            means.append(value)
            variances.append(one)
            weights.append(density / 6.0)
        weight = np.array(weights) / sum(weights)
        mean = weight @ np.array(means)
        shift += mean - values
        variance += weight @ np.array(variances) - first + weight @ (np.array(means) - mean) ** 2
    return shift, np.maximum(variance, first)


def _given(
    fields: Fields, likelihood: FieldLikelihood, logarithms: FloatArray, prior: RoughnessPrior
) -> tuple[FloatArray, FloatArray, float] | None:
    """The linear functions' part in the fields and their variances with these hyperparameters, shape (q,).

    With them minus the logarithm of the hyperparameters' posterior.
    """
    one = fields_on(fields.travel_m, fields.time_s, _roughness(logarithms), fields.smoothness)
    factor = _Factor.of(likelihood.information + one.precision)
    if factor is None:
        return None
    solved = factor.solve(np.column_stack([likelihood.pull, likelihood.of_fields.T]))
    values = likelihood.of_fields @ solved[:, 0]
    variances = likelihood.others + np.sum(likelihood.of_fields.T * solved[:, 1:], axis=0)
    posterior = _minus_logarithm(factor, one, likelihood.pull, solved[:, 0]) + 0.5 * prior.squares(logarithms)[0]
    return values, variances, posterior


def _minus_logarithm(factor: _Factor, fields: Fields, pull: FloatArray, mean: FloatArray) -> float:
    """Minus the logarithm of the marginal likelihood, with G + Q factorised and the fields' mean given it."""
    return 0.5 * (factor.log_determinant - fields.log_determinant - float(pull @ mean))


def _roughness(logarithms: FloatArray) -> Roughness:
    return roughness_of(np.append(logarithms, -50.0))


def surprise(
    fields: Fields, likelihood: FieldLikelihood, logarithms: FloatArray, smoothness: int
) -> tuple[float, FloatArray]:
    """Return minus the logarithm of the marginal likelihood of these hyperparameters, shape (5,), and its slope."""
    rough = _roughness(logarithms)
    one = fields_on(fields.travel_m, fields.time_s, rough, smoothness)
    factor = _Factor.of(likelihood.information + one.precision)
    if factor is None:
        return math.inf, np.zeros(_LAWS)
    mean = factor.solve(likelihood.pull)
    value = _minus_logarithm(factor, one, likelihood.pull, mean)
    # E[w w'], of which the slopes are made
    second = factor.inverse() + np.outer(mean, mean)
    slopes = [*_travel_slopes(fields, rough, one, second), *_wander_slopes(fields, rough, second)]
    return value, np.array(slopes)


def _travel_slopes(fields: Fields, rough: Roughness, one: Fields, second: FloatArray) -> list[float]:
    count = fields.travel_m.size
    by_length = travel_correlation(fields.travel_m, rough.length_m, one.smoothness)[1]
    # the inverse of the correlation, from the precisions of both directions' sum and difference
    opening, closing = slice(0, count), slice(count, 2 * count)
    inverse = (one.precision[opening, opening] - one.precision[opening, closing]) * rough.own_n**2
    both = 0.5 * (second[opening, opening] + second[closing, closing])
    cross = 0.5 * (second[opening, closing] + second[closing, opening])
    of_sum, of_difference = 2.0 * rough.common_n**2 + rough.own_n**2, rough.own_n**2
    in_sum, in_difference = float(np.sum((both + cross) * inverse)), float(np.sum((both - cross) * inverse))
    by_sum = 0.5 * (count / of_sum - in_sum / of_sum**2)
    by_difference = 0.5 * (count / of_difference - in_difference / of_difference**2)
    turned = inverse @ by_length @ inverse
    length = float(np.sum(inverse * by_length)) - 0.5 * (
        float(np.sum((both + cross) * turned)) / of_sum + float(np.sum((both - cross) * turned)) / of_difference
    )
    own = 2.0 * rough.own_n**2
    return [by_sum * 4.0 * rough.common_n**2, (by_sum + by_difference) * own, length]


def _wander_slopes(fields: Fields, rough: Roughness, second: FloatArray) -> list[float]:
    part = slice(2 * fields.travel_m.size, fields.count)
    slopes = []
    for name in ("wander_n", "wander_s"):
        sides = []
        for sign in (1.0, -1.0):
            changed = replace(rough, **{name: getattr(rough, name) * math.exp(sign * _STEP)})
            precision, logarithm = wander_precision(fields.time_s, changed)
            sides.append(0.5 * (float(np.sum(second[part, part] * precision)) - logarithm))
        slopes.append((sides[0] - sides[1]) / (2.0 * _STEP))
    return slopes
