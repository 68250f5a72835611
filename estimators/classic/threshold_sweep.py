"""Method 1's first step: the regression for every threshold of speed (Romano & Garcia 2007, Eq. 5 to 7), at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from estimators.linear_fit import LEAST_INDEPENDENCE, predicted_bias
from estimators.linear_fit_kernel import squares
from estimators.samples import FloatArray, IntArray

_ROUNDING: Final = 1.0e-15


@dataclass(frozen=True, slots=True, eq=False)
class ThresholdSweep:
    """Coefficients, shape (S, p), their errors, (S, p), and the rows used, (S,), at thresholds s = 1..S.

    ``std_error`` holds the scatter of ordinary least squares and the bias that noise makes; it is infinite where
    the rows do not determine the coefficients. ``step_m_per_s`` is |v|max / Z.
    """

    coefficients: FloatArray
    std_error: FloatArray
    rows: IntArray
    step_m_per_s: float

    @property
    def thresholds_m_per_s(self) -> FloatArray:
        """Thresholds of speed, m/s, shape (S,): s |v|max / Z (Eq. 7 with the largest speed)."""
        return np.asarray(self.step_m_per_s * np.arange(1, self.rows.size + 1))


def sweep_thresholds(
    columns: FloatArray, target: FloatArray, speed: FloatArray, noise: FloatArray, *, steps: int, parts: int
) -> ThresholdSweep:
    """Least squares of ``target`` on ``columns`` over the rows with ``speed`` > s |v|max / Z, s = 1..S.

    Each row is put into the bin of the last threshold that it passes; sums from the top give every threshold's
    normal equations in one pass. ``steps`` is S, ``parts`` is Z; ``noise`` is one row's noise covariance.
    ``target``, ``speed``: shape (n,); ``columns``: shape (n, p); ``noise``: shape (p, p); in any units.
    """
    width = columns.shape[1]
    largest = float(speed.max(initial=0.0))
    if largest <= 0.0:
        return _undetermined(steps, width)
    passed = np.clip(np.ceil(speed * (parts / largest)).astype(np.int64) - 1, 0, steps)
    kept = np.flatnonzero(passed > 0)
    if kept.size <= width:
        return _undetermined(steps, width)
    columns = np.ascontiguousarray(columns)
    scale = np.sqrt(squares(columns, kept) / kept.size)
    scale[scale == 0.0] = 1.0
    binned = _binned_products(columns, target, 1.0 / scale, passed, steps)
    sums = np.cumsum(binned[:0:-1], axis=0)[::-1]
    rows = np.cumsum(np.bincount(passed[kept], minlength=steps + 1)[:0:-1])[::-1]
    return _solved(sums, rows, scale, noise, largest / parts)


def _sum_products(
    columns: FloatArray, target: FloatArray, weight: FloatArray, passed: IntArray, steps: int
) -> FloatArray:
    """Sums of products of the scaled columns and the target, bin by bin, shape (steps + 1, p + 1, p + 1)."""
    width = columns.shape[1]
    sums = np.zeros((steps + 1, width + 1, width + 1))
    row = np.empty(width + 1)
    for index in range(target.size):
        if passed[index] == 0:
            continue
        for column in range(width):
            row[column] = columns[index, column] * weight[column]
        row[width] = target[index]
        table = sums[passed[index]]
        for one in range(width + 1):
            for other in range(one + 1):
                table[one, other] += row[one] * row[other]
    for table in sums:
        for one in range(width + 1):
            for other in range(one):
                table[other, one] = table[one, other]
    return sums


_binned_products: Callable[[FloatArray, FloatArray, FloatArray, IntArray, int], FloatArray] = njit(cache=True)(
    _sum_products
)


def _undetermined(steps: int, width: int) -> ThresholdSweep:
    return ThresholdSweep(
        np.zeros((steps, width)), np.full((steps, width), np.inf), np.zeros(steps, dtype=np.int64), 0.0
    )


def _solved(sums: FloatArray, rows: IntArray, scale: FloatArray, noise: FloatArray, step: float) -> ThresholdSweep:
    width = scale.size
    normal, moment = sums[:, :width, :width], sums[:, :width, width]
    diagonal = np.sqrt(np.clip(np.einsum("sii->si", normal), 0.0, None))
    # as correlations, with the inverse's diagonal as the measure of how far the regressors are independent
    norm = np.where(diagonal > 0.0, diagonal, 1.0)
    correlation = normal / (norm[:, :, None] * norm[:, None, :])
    enough = (rows > width + 3) & (diagonal > 0.0).all(axis=1)
    safe = np.where(enough[:, None, None], correlation + _ROUNDING * np.eye(width), np.eye(width))
    # of regressors that are one to the last digit the pivot may be 0 all the same
    enough &= np.linalg.det(safe) > 0.0
    safe[~enough] = np.eye(width)
    inverse = np.linalg.inv(safe)
    inflation = np.einsum("sii->si", inverse)
    determined = enough & (inflation > 0.0).all(axis=1) & (inflation < 1.0 / LEAST_INDEPENDENCE**2).all(axis=1)
    inverse[~determined] = np.eye(width)
    bread = inverse / (norm[:, :, None] * norm[:, None, :])
    scaled = np.einsum("sij,sj->si", bread, moment)
    total = sums[:, width, width]
    # the difference is known to the rounding of its terms only
    residual = np.maximum(total - np.einsum("si,si->s", scaled, moment), _ROUNDING * total)
    variance = residual / np.maximum(rows - width, 1)
    bias = predicted_bias(bread, rows[:, None, None] * (noise / np.outer(scale, scale)), scaled)
    spread = variance[:, None] * np.einsum("sii->si", bread)
    error = np.sqrt(np.clip(spread, 0.0, None) + bias**2) / scale
    error[~determined] = np.inf
    return ThresholdSweep(scaled / scale, error, rows, step)
