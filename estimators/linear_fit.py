"""Least squares with errors that are honest about autocorrelation and about noise in the regressors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg.lapack import dpotri

from estimators.linear_fit_kernel import block_scores, gram, residuals, squares
from estimators.samples import BoolArray, FloatArray, IntArray

# Share of the attenuation that is undone when the bias is predicted: below 1, so that a fit that is all noise
# (attenuation 1) gets a bias of 10 times its value instead of one without bound.
ATTENUATION_UNDONE: Final = 0.9
# Own choices.
LEAST_INDEPENDENCE: Final = 1.0e-4  # share of a column that the others do not explain; 0.1 to 1 on the paper's valves
LAGS: Final = 8  # of blocks, each a 1000th of the rows: 0.3 s of a 60 s triangle at 1 ms
MOST_BLOCKS: Final = 1000
TRIM: Final = 4.0  # residuals, in root mean squares of the rows beyond doubt
MOST_TRIMS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Coefficients, shape (p,), the covariance of their scatter, (p, p), and the bias expected of noise."""

    coefficients: FloatArray
    covariance: FloatArray
    noise_bias: FloatArray
    residual_rms: float
    samples: int

    @property
    def std_error(self) -> FloatArray:
        """Scatter and expected bias together, shape (p,)."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.covariance), 0.0, None) + self.noise_bias**2))


def inverse_of(lower: FloatArray) -> FloatArray:
    """Return the inverse of L L', symmetric, from L as Cholesky's factorisation leaves it, shape (n, n), in any unit.

    What stands above the diagonal is not read.
    """
    half, _ = dpotri(lower, lower=1)
    return np.asarray(np.tril(half) + np.tril(half, -1).T)


def fit_linear(
    columns: FloatArray, target: FloatArray, chosen: BoolArray, noise: FloatArray | None = None
) -> LinearFit | None:
    """Least squares of ``target`` on ``columns`` over the ``chosen`` rows; None where they do not suffice.

    The covariance is Newey and West's (1987) on blocks of rows, so that it reaches over long autocorrelation; rows
    that are not chosen count as gaps. ``noise`` is the covariance of the noise in one row of ``columns``.
    ``target``, ``chosen``: shape (n,); ``columns``: shape (n, p); ``noise``: shape (p, p); in any units.
    """
    return fit_trimmed(columns, target, chosen, np.zeros(chosen.size, dtype=np.bool_), noise)


def fit_trimmed(
    columns: FloatArray, target: FloatArray, chosen: BoolArray, doubtful: BoolArray, noise: FloatArray | None = None
) -> LinearFit | None:
    """As ``fit_linear``, any units, without ``doubtful`` rows, shape (n,), that the fit to the others contradicts."""
    rows = np.flatnonzero(chosen)
    if rows.size < columns.shape[1] + 2:
        return None
    columns = np.ascontiguousarray(columns)
    scale = np.sqrt(squares(columns, rows) / rows.size)
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return None
    weight = 1.0 / scale
    sure, kept = rows[~doubtful[rows]], rows[doubtful[rows]]
    sums = gram(columns, target, sure, weight)
    solved = _solve(sums + gram(columns, target, kept, weight), sure.size + kept.size)
    for _ in range(MOST_TRIMS):
        if solved is None or kept.size == 0 or sure.size <= columns.shape[1] + 2:
            break
        beyond_doubt = residuals(columns, target, sure, weight, solved[0])
        limit = TRIM * float(np.sqrt(beyond_doubt @ beyond_doubt / sure.size))
        fitting = kept[np.abs(residuals(columns, target, kept, weight, solved[0])) <= limit]
        if fitting.size == kept.size:
            break
        kept = fitting
        solved = _solve(sums + gram(columns, target, kept, weight), sure.size + kept.size)
    if solved is None:
        return None
    rows = np.sort(np.concatenate([sure, kept])) if kept.size else sure
    return _described(columns, target, rows, scale, solved=solved, noise=noise)


def _solve(sums: FloatArray, count: int) -> tuple[FloatArray, FloatArray] | None:
    """Coefficients (p,) and (X'X)^-1 (p, p) from sums of products (p + 1, p + 1); None where not independent."""
    width = sums.shape[0] - 1
    normal = sums[:width, :width]
    norm = np.sqrt(np.diag(normal))
    if count < width + 2 or not (norm > 0.0).all():
        return None
    try:
        root = np.linalg.cholesky(normal / np.outer(norm, norm))
    except np.linalg.LinAlgError:
        return None
    if float(np.diag(root).min()) < LEAST_INDEPENDENCE:
        return None
    half = np.linalg.inv(root)
    bread = half.T @ half / np.outer(norm, norm)
    return bread @ sums[:width, width], bread


def _described(
    columns: FloatArray,
    target: FloatArray,
    rows: IntArray,
    scale: FloatArray,
    *,
    solved: tuple[FloatArray, FloatArray],
    noise: FloatArray | None,
) -> LinearFit:
    """The fit in its own units, with its covariance and the bias that noise is expected to make."""
    coefficients, bread = solved
    count, width = rows.size, columns.shape[1]
    residual = residuals(columns, target, rows, 1.0 / scale, coefficients)
    # one step of refinement makes good what the normal equations lose
    coefficients = coefficients + bread @ block_scores(columns, rows, 1.0 / scale, residual, target.size)[0]
    residual = residuals(columns, target, rows, 1.0 / scale, coefficients)
    scores = block_scores(columns, rows, 1.0 / scale, residual, max(1, count // MOST_BLOCKS))
    covariance = bread @ _newey_west(scores, LAGS) @ bread * (count / (count - width))
    bias = np.zeros(width)
    if noise is not None:
        bias = predicted_bias(bread, count * noise / np.outer(scale, scale), coefficients)
    rms = float(np.sqrt(np.mean(residual * residual)))
    return LinearFit(coefficients / scale, covariance / np.outer(scale, scale), bias / scale, rms, count)


def _newey_west(scores: FloatArray, lags: int) -> FloatArray:
    """Long-run covariance of the scores' sum, (p, p), from scores (n, p): Bartlett weights, Newey and West (1987)."""
    meat = np.asarray(scores.T @ scores)
    for lag in range(1, min(lags, scores.shape[0] - 1) + 1):
        shifted = scores[lag:].T @ scores[:-lag]
        meat = meat + (1.0 - lag / (lags + 1.0)) * (shifted + shifted.T)
    return np.asarray(meat)


def predicted_bias(bread: FloatArray, noise: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Expected attenuation (errors in variables) of coefficients, shape (..., p), from (X'X)^-1 and the noise in X'X.

    With G = (X'X)^-1 N the fit is (1 - G) times the truth; the bias is G (1 - 0.9 G)^-1 times the fit.
    These two: shape (..., p, p). Any units.
    """
    gain = bread @ noise
    if not noise.any():
        return np.zeros_like(coefficients)
    undone = np.eye(coefficients.shape[-1]) - ATTENUATION_UNDONE * gain
    try:
        restored = np.linalg.solve(undone, coefficients[..., None])
    except np.linalg.LinAlgError:
        # only where an attenuation is 1/0.9 to the last digit, that is for pure noise
        restored = 10.0 * coefficients[..., None]
    return np.asarray((gain @ restored)[..., 0])
