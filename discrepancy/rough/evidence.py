"""The marginal likelihood of the balance with friction that varies, with and without laws beyond the plain valve.

The rows are linear in k, F_0, F_c, F_s, two delays and the sizes of the laws; friction's variation along the travel and
in time, the scatter of the breakaways and what is left from block to block are Gaussian with hyperparameters that the
same marginal likelihood finds. So the null and every candidate are compared with everything free, in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor
from scipy.optimize import minimize
from scipy.special import chdtri

from discrepancy.rough.observations import Observations
from discrepancy.rough.setting import Setting
from estimators.engine.breakaways import LATENESS_S
from estimators.engine.parameters import Known
from estimators.engine.roughness import ROUGH, field_covariance, field_slopes, roughness_of
from estimators.linear_fit import inverse_of

FloatArray = npt.NDArray[np.float64]

SYMBOLS: Final = ("k", "F_0", "F_c", "F_s", "lag", "lateness")
NAMES: Final = ("common", "own", "length", "wander", "wander_time", "error", "scatter")
# What packings have, as shares of F_c (scatter: of F_s), and standard deviations of the logarithms above and below it:
# few are rougher, but a packing may be as good as ideal.
_MEDIAN: Final = {"common": 0.01, "own": 0.01, "wander": 0.006, "error": 0.001, "scatter": 0.025}
_ABOVE: Final = {
    "common": 0.6, "own": 0.6, "length": 0.5, "wander": 0.6, "wander_time": 0.7, "error": 1.5, "scatter": 0.6,
}  # fmt: skip
_BELOW: Final = {**_ABOVE, "common": 3.0, "own": 3.0, "wander": 3.0, "scatter": 3.0, "error": 3.0}
_ALIKE: Final = 0.7  # spread of the logarithm of common over own
_LENGTH: Final = 0.025  # of the travel
_WANDER_S: Final = 30.0
_LOWEST: Final = 1.0e-3  # of the median
_RANGE: Final = 5.0  # standard deviations of a logarithm at most
# By how much a bench set and its reading may be off without a fault: of the full force, and of F_c.
_PRELOAD_SHARE: Final = 0.003
_PRELOAD_OF_FRICTION: Final = 0.005
_NO_SPRING: Final = 1.0e-6  # of F_c over the travel
_VISCOUS: Final = 0.3  # of F_c at the usual speed
_SEARCH: Final = {"maxiter": 25, "ftol": 1.0e-5}  # a hundredth of a nat
_NOT_BOTH_ENDS: Final = 0.025  # of the chance, at each end of a 95 % interval
_FLAT: Final = 1.0e-12  # information of a parameter, in its scaled unit, of which nothing is known
_FEWEST_OF_PARABOLA: Final = 12  # blocks of one direction


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of laws, shape (n, c), that enter linearly, and what is known of each size beforehand, shape (c,)."""

    values: FloatArray
    spread: FloatArray
    mean: FloatArray

    def with_column(self, column: FloatArray, spread: float, mean: float = 0.0) -> Columns:
        """Return these and one more, shape (n,), N by the unit of its size."""
        return Columns(
            np.column_stack([self.values, column]), np.append(self.spread, spread), np.append(self.mean, mean)
        )


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Rows, the null's columns and what is known beforehand of their values."""

    rows: Observations
    design: FloatArray
    prior_mean: FloatArray
    prior_information: FloatArray
    medians: FloatArray  # of the hyperparameters' logarithms
    share: float  # F_s over F_c, by which a breakaway has the friction's fields
    law_share: float  # the same for laws

    @property
    def no_columns(self) -> Columns:
        """No law at all."""
        return Columns(np.empty((self.rows.count, 0)), np.empty(0), np.empty(0))


def problem_of(rows: Observations, setting: Setting, lag: Known) -> Problem:
    """Return the balance of these rows with the priors of this valve."""
    slide = rows.is_slide.astype(np.float64)
    apart = 1.0 - slide
    design = np.column_stack(
        [
            rows.travel_m,
            np.ones(rows.count),
            slide * rows.direction,
            apart * rows.direction,
            slide * (rows.rate_n_per_s * _swiftness(rows) if rows.has_spring else rows.speed_m_per_s),
            apart * rows.rate_n_per_s,
        ]
    )
    mean, information = np.zeros(len(SYMBOLS)), np.zeros(len(SYMBOLS))
    if setting.preload_n is not None:
        error_n = math.hypot(_PRELOAD_SHARE * setting.full_force_n, _PRELOAD_OF_FRICTION * setting.friction_n)
        mean[1], information[1] = setting.preload_n, error_n**-2.0
    mean[4], information[4] = lag.value, lag.std_error**-2.0
    if not rows.has_spring:
        # no spring rate, and F_v in the delay's place
        information[0] = (_NO_SPRING * setting.friction_n / setting.travel_m) ** -2.0
        mean[4], information[4] = 0.0, (_VISCOUS * setting.friction_n / setting.speed_m_per_s) ** -2.0
    information[5] = LATENESS_S**-2.0
    # nothing shows F_s without a breakaway
    information[3] = (10.0 * setting.static_n) ** -2.0
    mean[3] = setting.static_n
    friction = setting.friction_n
    medians = np.log(
        [
            _MEDIAN["common"] * friction,
            _MEDIAN["own"] * friction,
            _LENGTH * setting.travel_m,
            _MEDIAN["wander"] * friction,
            _WANDER_S,
            _MEDIAN["error"] * friction,
            _MEDIAN["scatter"] * setting.static_n,
        ]
    )
    share = setting.static_n / max(friction, 1.0e-9)
    return Problem(rows, design, mean, information, medians, share, share)


def _swiftness(rows: Observations) -> FloatArray:
    """Speed of the stem at each row for the force's rate there, over the usual one, shape (n,).

    Friction or a spring that grows with travel makes the same rate drive a slower stem, one way more than back, and so
    less of a viscous force. It is read off each direction's force by a parabola of the travel.
    """
    swiftness = np.ones(rows.count)
    found: list[tuple[npt.NDArray[np.bool_], FloatArray]] = []
    for direction in (1.0, -1.0):
        chosen = rows.is_slide & (rows.direction == direction)
        if int(chosen.sum()) < _FEWEST_OF_PARABOLA:
            return swiftness
        travel_m = rows.travel_m[chosen]
        away = (travel_m - travel_m.mean()) / max(float(travel_m.std()), 1.0e-12)
        rate = rows.rate_n_per_s[chosen]
        design = np.column_stack([np.ones(away.size), away, away**2, rate / float(np.abs(rate).max())])
        values, *_ = np.linalg.lstsq(design, rows.force_n[chosen], rcond=None)
        found.append((chosen, np.asarray(values[1] + 2.0 * values[2] * away) / max(float(travel_m.std()), 1.0e-12)))
    usual = float(np.mean([stiffness.mean() for _, stiffness in found]))
    for chosen, stiffness in found:
        swiftness[chosen] = usual / np.clip(stiffness, 0.5 * usual, 2.0 * usual) if usual > 0.0 else 1.0
    return swiftness


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The balance for one set of hyperparameters; values and covariance of SYMBOLS, then of the columns' sizes.

    ``cost`` is minus the logarithm of the marginal likelihood, the hyperparameters' prior with it.
    """

    problem: Problem
    columns: Columns
    logarithms: FloatArray
    cost: float
    values: FloatArray
    covariance: FloatArray
    projection: FloatArray
    weighted: FloatArray
    whole: FloatArray  # covariance of the rows

    def known(self, symbol: str) -> Known:
        """Return value and standard error of this symbol."""
        at = SYMBOLS.index(symbol)
        return Known(float(self.values[at]), math.sqrt(max(float(self.covariance[at, at]), 0.0)))

    def given(self, symbol: str, value: float) -> Solved:
        """Return the model whose values are those expected where this symbol has that value."""
        at = SYMBOLS.index(symbol)
        step = (value - float(self.values[at])) / max(float(self.covariance[at, at]), 1.0e-300)
        return replace(self, values=self.values + step * self.covariance[:, at])

    def size(self, number: int) -> Known:
        """Return value and standard error of a column's size."""
        at = len(SYMBOLS) + number
        return Known(float(self.values[at]), math.sqrt(max(float(self.covariance[at, at]), 0.0)))

    @property
    def sizes(self) -> FloatArray:
        """Sizes of all columns, shape (c,)."""
        return self.values[len(SYMBOLS) :]

    def total(self, numbers: Sequence[int]) -> Known:
        """Return the sum of the sizes of these columns, of one law, with its standard error."""
        at = len(SYMBOLS) + np.asarray(numbers, dtype=np.int64)
        variance = float(self.covariance[np.ix_(at, at)].sum())
        return Known(float(self.values[at].sum()), math.sqrt(max(variance, 0.0)))

    def hyperparameter(self, name: str) -> float:
        """Return a hyperparameter in its unit."""
        return math.exp(float(self.logarithms[NAMES.index(name)]))

    def apart(self, column: FloatArray) -> FloatArray:
        """What of a column, N, shape (n,), the plain valve's parameters and the columns do not take up."""
        design = np.hstack([self.problem.design, self.columns.values])
        scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1.0e-300)
        taken, *_ = np.linalg.lstsq(design / scale, column, rcond=None)
        return np.asarray(column - design / scale @ taken)

    @property
    def mean_n(self) -> FloatArray:
        """The actuator's force of each row by the mean law, without the friction's variation, N."""
        whole = np.hstack([self.problem.design, self.columns.values])
        return np.asarray(whole @ self.values)

    @property
    def informed(self) -> Problem:
        """The problem with the force and with F_s over F_c that laws depend on as found here."""
        rows = replace(self.problem.rows, smooth_n=self.mean_n)
        friction_n, static_n = self.known("F_c").value, self.known("F_s").value
        share = static_n / friction_n if static_n > friction_n > 0.0 else 1.0
        return replace(self.problem, rows=rows, law_share=share if rows.has_breakaways else self.problem.law_share)

    @property
    def left_n(self) -> FloatArray:
        """What the mean law leaves of each row, N, in its direction."""
        return np.asarray(self.problem.rows.direction * (self.problem.rows.force_n - self.mean_n))

    def gains(self, columns: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """By how much each further column, shape (n, g), raises the logarithm of the marginal likelihood; size, error.

        The hyperparameters stay.
        """
        answer = np.maximum(np.einsum("ng,nm,mg->g", columns, self.projection, columns, optimize=True), 0.0)
        slope = columns.T @ self.weighted
        information = answer + spread**-2.0
        gain = 0.5 * slope**2 / information - 0.5 * np.log1p(answer * spread**2)
        return gain, slope / information, information**-0.5


def _prior(problem: Problem, logarithms: FloatArray) -> tuple[float, FloatArray]:
    off = logarithms - problem.medians
    spread = np.where(off > 0.0, [_ABOVE[name] for name in NAMES], [_BELOW[name] for name in NAMES])
    away = off / spread
    ratio = float(logarithms[0] - logarithms[1]) / _ALIKE
    slope = away / spread
    slope[:2] += np.array([1.0, -1.0]) * ratio / _ALIKE
    return 0.5 * (float(away @ away) + ratio**2), slope


def solved(problem: Problem, columns: Columns, logarithms: FloatArray) -> Solved:
    """Solve the balance for the logarithms of the hyperparameters in the order of NAMES, shape (7,)."""
    return _solved(problem, columns, logarithms)[0]


def _solved(problem: Problem, columns: Columns, logarithms: FloatArray) -> tuple[Solved, FloatArray]:
    rows = problem.rows
    roughness = roughness_of(logarithms[:6])
    scatter_n = math.exp(float(logarithms[6]))
    share = np.where(rows.is_slide, 1.0, problem.share)
    both = np.outer(share, share)
    places = rows.travel_m, rows.time_s, rows.direction
    own = np.where(rows.is_slide, roughness.error_n**2, 0.0)
    scatter = np.where(rows.is_slide, 0.0, scatter_n**2)
    whole = both * field_covariance(*places, roughness, ROUGH) + np.diag(rows.variance_n2 + own + scatter)
    factor = cho_factor(whole, lower=True, check_finite=False)
    inverse = inverse_of(factor[0])
    design = np.hstack([problem.design, columns.values])
    mean = np.concatenate([problem.prior_mean, columns.mean])
    information = np.concatenate([problem.prior_information, columns.spread**-2.0])
    size = np.sqrt(np.mean(design**2, axis=0))
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    scaled, known = design * scale, information * scale**2
    inverse_design = inverse @ scaled
    normal = scaled.T @ inverse_design + np.diag(known + _FLAT * np.diag(scaled.T @ inverse_design) + 1.0e-300)
    theta_covariance = np.linalg.inv(normal)
    theta = theta_covariance @ (inverse_design.T @ rows.force_n + known * mean / scale)
    left = rows.force_n - scaled @ theta
    weighted = inverse @ left
    projection = inverse - inverse_design @ theta_covariance @ inverse_design.T
    off = theta - mean / scale
    # the columns' scales cancel between models, the spread of a size beforehand does not
    log_determinant = 2.0 * float(np.log(np.diag(factor[0])).sum()) + float(np.linalg.slogdet(normal)[1])
    log_determinant -= 2.0 * float(np.log(scale).sum()) - 2.0 * float(np.log(columns.spread).sum())
    prior, prior_slope = _prior(problem, logarithms)
    cost = 0.5 * (log_determinant + float(left @ weighted) + float(known @ off**2)) + prior
    weight = projection - np.outer(weighted, weighted)
    diagonal = np.diag(weight)
    slopes = [
        *(0.5 * field_slopes(*places, roughness, ROUGH, weight=both * weight)),
        own @ diagonal,
        scatter @ diagonal,
    ]
    values, errors = theta * scale, theta_covariance * np.outer(scale, scale)
    found = Solved(problem, columns, logarithms, cost, values, errors, projection, weighted, whole)
    return found, np.array(slopes) + prior_slope


def fitted(problem: Problem, columns: Columns, start: FloatArray | None = None) -> Solved:
    """Return the balance with the likeliest hyperparameters; ``start``: logarithms in NAMES' order, shape (7,)."""
    low = [max(-_RANGE * _BELOW[name], math.log(_LOWEST)) for name in NAMES]
    high = [_RANGE * _ABOVE[name] for name in NAMES]
    bounds = list(zip(problem.medians + low, problem.medians + high, strict=True))

    def objective(at: FloatArray) -> tuple[float, FloatArray]:
        one, slope = _solved(problem, columns, at)
        return one.cost, slope

    begin = problem.medians if start is None else start
    found = minimize(objective, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=_SEARCH)  # type: ignore[call-overload]
    return solved(problem, columns, np.asarray(found.x))


def surely(deviation: float, free: int) -> float:
    """Return the low end of the 95 % interval of a standard deviation that so many free differences show.

    In the deviation's unit; 0 where there are none.
    """
    return deviation * math.sqrt(free / float(chdtri(free, _NOT_BOTH_ENDS))) if free > 0 else 0.0


def of_rows(problem: Problem, chosen: npt.NDArray[np.bool_]) -> Problem:
    """Return the problem of the ``chosen`` rows, shape (n,), alone."""
    return replace(problem, rows=problem.rows.rows(chosen), design=problem.design[chosen])
