"""The compiled sums of least squares: one pass over the chosen rows, without copies of them.

``rows`` (r,) are the row numbers used; ``weight`` (p,) multiplies the columns. Compiled from plain functions, so that
their types are checked as they stand here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray, IntArray


def _gram(columns: FloatArray, target: FloatArray, rows: IntArray, weight: FloatArray) -> FloatArray:
    """Products of the scaled columns and the target, summed over the rows, shape (p + 1, p + 1)."""
    width = columns.shape[1]
    sums = np.zeros((width + 1, width + 1))
    values = np.empty(width + 1)
    for row in rows:
        for column in range(width):
            values[column] = columns[row, column] * weight[column]
        values[width] = target[row]
        for one in range(width + 1):
            for other in range(one + 1):
                sums[one, other] += values[one] * values[other]
    for one in range(width + 1):
        for other in range(one):
            sums[other, one] = sums[one, other]
    return sums


def _residuals(
    columns: FloatArray, target: FloatArray, rows: IntArray, weight: FloatArray, coefficients: FloatArray
) -> FloatArray:
    """Target less fit at the rows, shape (r,)."""
    left = np.empty(rows.size)
    own = weight * coefficients
    for place in range(rows.size):
        row = rows[place]
        value = target[row]
        for column in range(columns.shape[1]):
            value -= columns[row, column] * own[column]
        left[place] = value
    return left


def _scores(columns: FloatArray, rows: IntArray, weight: FloatArray, residual: FloatArray, block: int) -> FloatArray:
    """Sums of column times residual over blocks of ``block`` consecutive row numbers, shape (blocks, p)."""
    width = columns.shape[1]
    first = rows[0]
    sums = np.zeros(((rows[-1] - first) // block + 1, width))
    for place in range(rows.size):
        number = (rows[place] - first) // block
        for column in range(width):
            sums[number, column] += columns[rows[place], column] * residual[place]
    return sums * weight


def _squares(columns: FloatArray, rows: IntArray) -> FloatArray:
    """Sums of the columns' squares over the rows, shape (p,)."""
    sums = np.zeros(columns.shape[1])
    for row in rows:
        for column in range(columns.shape[1]):
            sums[column] += columns[row, column] ** 2
    return sums


gram: Callable[[FloatArray, FloatArray, IntArray, FloatArray], FloatArray] = njit(cache=True)(_gram)
residuals: Callable[[FloatArray, FloatArray, IntArray, FloatArray, FloatArray], FloatArray] = njit(cache=True)(
    _residuals
)
block_scores: Callable[[FloatArray, IntArray, FloatArray, FloatArray, int], FloatArray] = njit(cache=True)(_scores)
squares: Callable[[FloatArray, IntArray], FloatArray] = njit(cache=True)(_squares)
