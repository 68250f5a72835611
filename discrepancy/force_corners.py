"""The corners between which the force of a recording is straight, as a simulated stem takes them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from estimators.likelihood.inputs.input_path import InputPath, MeasuredPath
from estimators.likelihood.inputs.pressure_lines import MOST_VARIATIONS
from estimators.likelihood.lines.smooth_spans import SHAPE_ERROR
from estimators.likelihood.lines.stretches import DrawnPieces, Stretch
from estimators.samples import FloatArray

Corners = tuple[FloatArray, FloatArray]  # times, s, and force, N, both shape (n,)

_ROUNDING: Final = 1.0e-9  # of the force's range


def corners_from(begin_s: float, corner_s: FloatArray, corner_n: FloatArray) -> Corners:
    """Return the corners after a time, with one at that time itself."""
    after = corner_s > begin_s
    begin_n = np.interp(begin_s, corner_s, corner_n)
    return np.concatenate([[begin_s], corner_s[after]]), np.concatenate([[begin_n], corner_n[after]])


def deviations_of(path: InputPath, begins_s: Sequence[float]) -> Iterator[tuple[Corners, ...]]:
    """Yield the corners of parts that begin at these times for each direction in which a measured force is uncertain.

    Each is changed by one standard deviation.
    """
    if isinstance(path, MeasuredPath):
        for corner_s, corner_n in path.variations(np.zeros(len(path.nuisances))):
            yield tuple(corners_from(begin_s, corner_s, corner_n) for begin_s in begins_s)


def unresolved_variance(path: InputPath) -> tuple[float, float]:
    """Return the variance of a measured force that the deviations do not hold, and that which they do, in like units.

    A curve's pieces are as long as the noise lets them be, and what they lack of its shape is in no direction of
    theirs: it is counted in their size alone. Nor is there what is small, where there are too many directions.
    """
    if not isinstance(path, MeasuredPath):
        return 0.0, 0.0
    pairs = [pair for stretch in path.stretches for pair in zip(stretch.sizes(), _curved(stretch), strict=True)]
    pairs.sort(key=lambda pair: -pair[0])
    squares = np.array([float(size) ** 2 for size, _ in pairs])
    shape = (1.0 - 1.0 / SHAPE_ERROR**2) * np.array([curved for _, curved in pairs])
    kept = slice(0, MOST_VARIATIONS)
    unresolved = float(squares[kept] @ shape[kept]) + float(squares[MOST_VARIATIONS:].sum())
    return unresolved, float(squares[kept].sum())


def _curved(stretch: Stretch) -> FloatArray:
    """The share of each direction of a stretch's errors that is on curves, shape (d,)."""
    if not isinstance(stretch, DrawnPieces):
        return np.zeros(stretch.sizes().size)
    squares = np.square(stretch.pieces.root).sum(axis=2)
    all_of_it = np.maximum(squares.sum(axis=1), 1.0e-300)
    return np.asarray(squares[:, stretch.pieces.degree > 1].sum(axis=1) / all_of_it)


def flat_where_held(corner_n: FloatArray) -> FloatArray:
    """Return the force at corners, shape (n,), equal where a hold's line is tilted by rounding alone.

    A stem that rests on the edge of F_s = F_c would break away again and again on a slope of 1e-12 N/s.
    """
    held_n = corner_n.copy()
    least_n = _ROUNDING * float(np.ptp(corner_n)) if corner_n.size else 0.0
    for row in range(1, held_n.size):
        if abs(held_n[row] - held_n[row - 1]) <= least_n:
            held_n[row] = held_n[row - 1]
    return held_n
