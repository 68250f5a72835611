"""Residuals beside a fit whose unknowns are free: what a cause wins that they could not take up themselves."""

from __future__ import annotations

import numpy as np

from estimators.samples import FloatArray


class Projected:
    """Residuals without what the baseline's unknowns can take up."""

    def __init__(self, slopes: FloatArray, residual: FloatArray) -> None:
        """Take the slopes (p, count) of a fit's residuals, shape (count,)."""
        scale = np.sqrt(np.sum(slopes * slopes, axis=1))
        used = slopes[scale > 0.0] / scale[scale > 0.0, None]
        values, vectors = np.linalg.eigh(used @ used.T)
        kept = values > 1.0e-10 * values.max()
        self._basis = (vectors[:, kept] / np.sqrt(values[kept])).T @ used
        self._residual = self._without(residual)
        self._cost = max(float(self._residual @ self._residual), 1.0e-300)

    def _without(self, row: FloatArray) -> FloatArray:
        return np.asarray(row - self._basis.T @ (self._basis @ row))

    def along(self, change: FloatArray, low: float, high: float) -> tuple[float, float]:
        """Share of the cost that a multiple of this change within the bounds takes away, and the multiple."""
        own = self._without(change)
        square = float(own @ own)
        if square <= 1.0e-12 * max(float(change @ change), 1.0e-300):
            return 0.0, 1.0
        product = float(own @ self._residual)
        factor = min(max(-product / square, low), high)
        won = -2.0 * factor * product - factor * factor * square
        return won / self._cost, factor

    def direct(self, residual: FloatArray) -> float:
        """Share of the cost that these residuals lack."""
        own = self._without(residual)
        return 1.0 - float(own @ own) / self._cost
