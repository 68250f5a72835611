"""Least squares over windows of motion, and how unsure it is by what repeats: strokes in time, parts of the travel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import student_95
from estimators.samples import BoolArray, FloatArray, IntArray

# Own choices, from rough valves (benchmark classic_rough).
_TRIM: Final = 4.5  # of the residuals' robust standard deviation
_MOST_TRIMS: Final = 4
_MAD_TO_SIGMA: Final = 1.4826
_LEAST_INDEPENDENCE: Final = 1.0e-10
_WANDER_TIMES: Final = (0.15, 0.5, 1.5)  # of the record
_WANDER_SIZES: Final = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # of what a stroke scatters by alone


@dataclass(frozen=True, slots=True)
class Known:
    """A value with its standard error and the degrees of freedom of that."""

    value: float
    error: float
    freedom: float = math.inf

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval."""
        return student_95(self.freedom) * self.error

    def with_more(self, error: float) -> Known:
        """Return the same with another, independent error that is known as such (Welch and Satterthwaite)."""
        both = math.hypot(self.error, error)
        if both <= 0.0 or self.error <= 0.0:
            return Known(self.value, both)
        return Known(self.value, both, self.freedom * (both / self.error) ** 4)


@dataclass(frozen=True, slots=True)
class Lag:
    """What the measured force is late by, s: the middle of what may be, and its standard error."""

    late_s: float
    error_s: float


@dataclass(frozen=True, slots=True, eq=False)
class WindowFit:
    """Coefficients (p,) and residuals (n,), N; ``kept`` (n,) are the windows that took part.

    ``matrix`` and ``through`` (n, p) are regressors and instruments, ``weight`` (n,) what each window weighs.
    """

    coefficients: FloatArray
    residual_n: FloatArray
    kept: BoolArray
    matrix: FloatArray
    through: FloatArray
    target: FloatArray
    weight: FloatArray


def fit_windows(
    matrix: FloatArray, target: FloatArray, weight: FloatArray, through: FloatArray | None = None
) -> WindowFit | None:
    """Return the b with Z'W (y - X b) = 0 for ``target`` y (n,) and ``matrix`` X (n, p); None where not determined.

    ``through`` Z (n, p) are instruments: what moves with the regressors and not with the local friction. Without them
    it is weighted least squares. Windows far off the others (drop-outs) are left out.
    y is in N, X and Z are in SI; ``weight``: shape (n,).
    """
    through = matrix if through is None else through
    kept = np.ones(target.size, dtype=np.bool_)
    found = None
    for _ in range(_MOST_TRIMS):
        found = _solved(*_sums(matrix[kept], through[kept], target[kept], weight[kept]))
        if found is None:
            return None
        scaled = (target - matrix @ found) * np.sqrt(weight)
        spread = _MAD_TO_SIGMA * float(np.median(np.abs(scaled[kept])))
        inside = np.abs(scaled) <= _TRIM * spread if spread > 0.0 else kept
        if np.array_equal(inside, kept) or np.count_nonzero(inside) < matrix.shape[1] + 2:
            break
        kept = inside
    assert found is not None
    return WindowFit(found, target - matrix @ found, kept, matrix, through, target, weight)


def _sums(
    matrix: FloatArray, through: FloatArray, target: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    weighted = through * weight[:, None]
    return weighted.T @ matrix, weighted.T @ target


def _solved(normal: FloatArray, moment: FloatArray) -> FloatArray | None:
    rows = np.sqrt(np.sum(normal**2, axis=1))
    columns = np.sqrt(np.sum((normal / np.where(rows > 0.0, rows, 1.0)[:, None]) ** 2, axis=0))
    if not bool((rows > 0.0).all() and (columns > 0.0).all() and np.isfinite(rows).all()):
        return None
    scaled = normal / np.outer(rows, columns)
    if abs(float(np.linalg.det(scaled))) <= _LEAST_INDEPENDENCE:
        return None
    return np.asarray(np.linalg.solve(scaled, moment / rows) / columns)


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Covariance (p, p) of coefficients by what repeats, and its degrees of freedom."""

    covariance: FloatArray
    freedom: float

    def of(self, weights: FloatArray, value: float) -> Known:
        """Return the combination of coefficients by these weights, shape (p,), in SI, which has this value."""
        return Known(value, math.sqrt(max(0.0, float(weights @ self.covariance @ weights))), self.freedom)


def jackknife(fit: WindowFit, cluster: IntArray, stratum: IntArray) -> Scatter | None:
    """Covariance of the coefficients by leaving out one cluster at a time; None where too few repeat.

    ``cluster`` and ``stratum``, shape (n,), number what each window belongs to; clusters are compared within their
    stratum only (strokes up with strokes up). Wolter (2007), chapter 4: the sum over strata of (n - 1) / n times the
    squared differences. It holds what clusters have of their own, whatever hangs together inside them.
    """
    kept = fit.kept
    parts = [(int(s), int(c)) for s, c in sorted(set(zip(stratum[kept].tolist(), cluster[kept].tolist(), strict=True)))]
    sums = {}
    for one in parts:
        rows = kept & (stratum == one[0]) & (cluster == one[1])
        sums[one] = _sums(fit.matrix[rows], fit.through[rows], fit.target[rows], fit.weight[rows])
    normal, moment = sum(one[0] for one in sums.values()), sum(one[1] for one in sums.values())
    width = fit.coefficients.size
    covariance = np.zeros((width, width))
    freedom = 0
    for group in {one[0] for one in parts}:
        members = [one for one in parts if one[0] == group]
        if len(members) < 2:
            return None
        left = []
        for member in members:
            solved = _solved(np.asarray(normal - sums[member][0]), np.asarray(moment - sums[member][1]))
            if solved is None:
                return None
            left.append(solved)
        away = np.array(left) - np.mean(left, axis=0)
        covariance += (len(members) - 1) / len(members) * (away.T @ away)
        freedom += len(members) - 1
    return Scatter(covariance, float(freedom))


@dataclass(frozen=True, slots=True, eq=False)
class Strokes:
    """Mean residual friction of each stroke, N, at its middle time, s, with regressors (n, q)."""

    time_s: FloatArray
    friction_n: FloatArray
    regressors: FloatArray
    weight: FloatArray
    duration_s: float


def wandering_mean(strokes: Strokes, target: FloatArray) -> Known | None:
    """Return what a friction that wanders was beyond the fit, N, at regressors ``target``, shape (q,), over the record.

    Strokes scatter alone and wander together as an Ornstein-Uhlenbeck process of a size and a time that the restricted
    likelihood weighs; the mean over the record is predicted from the strokes (universal kriging).
    """
    count, width = strokes.regressors.shape
    if count < width + 2:
        return None
    grid_s = (np.arange(40) + 0.5) / 40 * strokes.duration_s
    apart = np.abs(strokes.time_s[:, None] - strokes.time_s[None, :])
    to_grid = np.abs(strokes.time_s[:, None] - grid_s[None, :])
    over_grid = np.abs(grid_s[:, None] - grid_s[None, :])
    alone = np.diag(strokes.weight.mean() / strokes.weight)
    found = []
    for time in _WANDER_TIMES:
        scale_s = time * strokes.duration_s
        for size in _WANDER_SIZES:
            inverse = np.linalg.inv(alone + size**2 * np.exp(-apart / scale_s))
            normal = strokes.regressors.T @ inverse @ strokes.regressors
            sign, log_normal = np.linalg.slogdet(normal)
            if sign <= 0.0:
                continue
            spread = np.linalg.inv(normal)
            beta = spread @ (strokes.regressors.T @ inverse @ strokes.friction_n)
            away = strokes.friction_n - strokes.regressors @ beta
            square = max(float(away @ inverse @ away) / (count - width), 1.0e-300)
            fit = -0.5 * (-np.linalg.slogdet(inverse)[1] + log_normal + (count - width) * math.log(square))
            together = size**2 * np.exp(-to_grid / scale_s).mean(axis=1)
            value = float(target @ beta + together @ inverse @ away)
            open_ = target - strokes.regressors.T @ inverse @ together
            own = size**2 * float(np.exp(-over_grid / scale_s).mean())
            variance = square * float(own - together @ inverse @ together + open_ @ spread @ open_)
            found.append((fit, value, max(0.0, variance)))
    if not found:
        return None
    fits, values, variances = np.array(found).T
    shares = np.exp(fits - fits.max())
    shares /= shares.sum()
    mean = float(shares @ values)
    return Known(mean, math.sqrt(float(shares @ (variances + (values - mean) ** 2))), float(count - width))
