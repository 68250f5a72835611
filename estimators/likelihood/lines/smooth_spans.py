"""A smooth stretch of a noisy channel: pieces with one slope where they meet, fitted together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from scipy.linalg import cho_solve_banded, cholesky_banded

from estimators.likelihood.lines.piece_factors import chunks_of, piece_factor
from estimators.samples import BoolArray, FloatArray, IntArray

# Weight of a line's or a parabola's own condition, in rows of unit noise a row of the piece.
_CONDITION: Final = 1.0e6
# Own choices: noise alone gives 6 +- 4 where 8 coefficients stand against the 2 that a piece has of its own.
_MISFIT: Final = 14.0
_CUT_ROUNDS: Final = 8
_FEWEST_ROWS: Final = 12
# What the choice of nodes leaves of the shape, besides the scatter: measured on sines of 8 s at 1-20 ms.
SHAPE_ERROR: Final = 1.8


def _normal(
    time_s: FloatArray, value: FloatArray, node_s: FloatArray, degree: IntArray, weight: float
) -> tuple[FloatArray, FloatArray]:
    """Lower bands, shape (4, 2 k + 2), and right side of the least squares for value and slope at each node.

    Cubic Hermite polynomials between nodes; the slope is scaled by the mean interval. A line's slopes are both its
    chord's, a parabola's add up to twice its chord's: rows of great weight.
    """
    count = node_s.size - 1
    unit_s = (node_s[count] - node_s[0]) / count
    bands, right = np.zeros((4, 2 * count + 2)), np.zeros(2 * count + 2)
    row = np.empty(4)
    rows = np.zeros(count)
    piece = 0
    for i in range(time_s.size):
        while piece < count - 1 and time_s[i] > node_s[piece + 1]:
            piece += 1
        length_s = node_s[piece + 1] - node_s[piece]
        s = (time_s[i] - node_s[piece]) / length_s
        row[0] = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s)
        row[1] = s * (1.0 - s) * (1.0 - s) * length_s / unit_s
        row[2] = s * s * (3.0 - 2.0 * s)
        row[3] = s * s * (s - 1.0) * length_s / unit_s
        rows[piece] += 1.0
        for one in range(4):
            right[2 * piece + one] += row[one] * value[i]
            for other in range(one + 1):
                bands[one - other, 2 * piece + other] += row[one] * row[other]
    for piece in range(count):
        share = (node_s[piece + 1] - node_s[piece]) / unit_s
        conditions = 3 - degree[piece]
        for number in range(conditions):
            row[0], row[1], row[2], row[3] = 1.0, 0.5 * share, -1.0, 0.5 * share
            if number == 1:
                row[0], row[1], row[2], row[3] = 0.0, share, 0.0, -share
            for one in range(4):
                for other in range(one + 1):
                    bands[one - other, 2 * piece + other] += weight * (rows[piece] + 1.0) * row[one] * row[other]
    return bands, right


normal: Callable[[FloatArray, FloatArray, FloatArray, IntArray, float], tuple[FloatArray, FloatArray]]
normal = njit(cache=True, error_model="numpy")(_normal)


def smooth_span(
    time_s: FloatArray, value: FloatArray, node_s: FloatArray, degree: IntArray, noise: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Nodes (k + 1,), degrees (k,) and coefficients (k, 4) of the pieces, and their changes (d, k, 4) by one sigma.

    It begins with these nodes and degrees. A piece whose halves, fitted each for itself, leave less than it does by
    more than noise explains is cut in two cubics, until none is. The piece from one node to the next is
    c0 + c1 u + c2 u^2 + c3 u^3 with u from -1 to 1. The changes are along the eigen-directions of the covariance.
    """
    level = float(value.mean())
    centred = value - level
    chunks = chunks_of(time_s, centred, 0.0)
    solved = _solved(time_s, centred, node_s, degree)
    for _ in range(_CUT_ROUNDS):
        cut = _misfitting(time_s, centred, chunks, node_s, solved.coefficient, noise=noise)
        if not cut.any():
            break
        node_s = np.sort(np.concatenate([node_s, 0.5 * (node_s[:-1] + node_s[1:])[cut]]))
        degree = np.repeat(np.where(cut, 3, degree), np.where(cut, 2, 1))
        solved = _solved(time_s, centred, node_s, degree)
    covariance = noise**2 * cho_solve_banded((solved.factor, True), np.eye(2 * node_s.size))
    variances, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    kept = variances > 0.0
    changes = SHAPE_ERROR * (directions[:, kept] * np.sqrt(variances[kept])).T
    unit_s = float(node_s[-1] - node_s[0]) / degree.size
    coefficient = solved.coefficient.copy()
    coefficient[:, 0] += level
    return node_s, degree, coefficient, np.array([_powers(change, node_s, unit_s) for change in changes])


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    coefficient: FloatArray
    factor: FloatArray


def _solved(time_s: FloatArray, value: FloatArray, node_s: FloatArray, degree: IntArray) -> _Solved:
    bands, right = normal(time_s, value, node_s, degree, _CONDITION)
    # a node that too few rows see would leave the matrix singular
    bands[0] *= 1.0 + 1.0e-13
    factor = cholesky_banded(bands, lower=True)
    unit_s = float(node_s[-1] - node_s[0]) / degree.size
    return _Solved(_powers(cho_solve_banded((factor, True), right), node_s, unit_s), factor)


def _misfitting(
    time_s: FloatArray,
    value: FloatArray,
    chunks: FloatArray,
    node_s: FloatArray,
    coefficient: FloatArray,
    *,
    noise: float,
) -> BoolArray:
    """Which pieces, shape (k,), leave more than their two halves, each a cubic of its own, beyond noise."""
    count = coefficient.shape[0]
    misfits = np.zeros(count, dtype=np.bool_)
    halves_s = np.interp(np.arange(2 * count + 1) / 2.0, np.arange(count + 1), node_s)
    edges = np.searchsorted(time_s, halves_s)
    edges[-1] = time_s.size
    for i in range(count):
        first, middle, last = (int(edge) for edge in edges[2 * i : 2 * i + 3])
        if min(middle - first, last - middle) < _FEWEST_ROWS:
            continue
        u = (time_s[first:last] - 0.5 * (node_s[i] + node_s[i + 1])) / (0.5 * (node_s[i + 1] - node_s[i]))
        c = coefficient[i]
        left = value[first:last] - (c[0] + u * (c[1] + u * (c[2] + u * c[3])))
        own = sum(
            float(piece_factor(time_s, value, chunks, begin, end, 0.0)[4, 4] ** 2)
            for begin, end in ((first, middle), (middle, last))
        )
        misfits[i] = float(left @ left) - own > _MISFIT * noise**2
    return misfits


def _powers(hermite: FloatArray, node_s: FloatArray, unit_s: float) -> FloatArray:
    """Coefficients of the powers of u, shape (k, 4), from value and scaled slope at each node."""
    value, slope = hermite[0::2], hermite[1::2]
    half = 0.5 * np.diff(node_s) / unit_s
    start, end, rise, fall = value[:-1], value[1:], slope[:-1] * half, slope[1:] * half
    return np.column_stack(
        [
            0.5 * (start + end) + 0.25 * (rise - fall),
            0.75 * (end - start) - 0.25 * (rise + fall),
            0.25 * (fall - rise),
            0.25 * (start - end) + 0.25 * (rise + fall),
        ]
    )
