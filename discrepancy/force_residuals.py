"""What a balance of forces leaves, along one coordinate, and by how much it exceeds white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.samples import FloatArray

_BINS: Final = 40
_LEAST_IN_BIN: Final = 3
_UNITS: Final = {"time": "s", "travel": "m", "speed": "m/s"}
_PIECES: Final = (1, 4, 16, 64, 256, 1024)
_FEWEST_PIECES: Final = 20
_SURE: Final = 3.0  # standard errors by which the variance of pieces must exceed that of white noise


@dataclass(frozen=True, slots=True, eq=False)
class Along:
    """A misfit along one coordinate: means in bins, shape (b,).

    ``direction`` is 1 opening, -1 closing, 0 both. ``share`` is how much of the misfit's variance the coordinate
    explains beyond what as many bins explain of residuals that hang together as these do.
    """

    coordinate: str
    direction: int
    at: FloatArray
    mean: FloatArray
    share: float

    @property
    def unit(self) -> str:
        """Unit of the coordinate."""
        return _UNITS[self.coordinate]


def along(name: str, direction: int, at: FloatArray, residual: FloatArray) -> Along:
    """Means of residuals, N, in bins of a coordinate ``at`` in its unit, shape (n,) each, and what it explains."""
    independent = residual.size / _correlation_length(residual)
    bins = int(np.clip(independent / 3.0, 2, _BINS))
    edges = np.linspace(float(at.min()), float(at.max()) + 1.0e-12, bins + 1)
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    used = count >= _LEAST_IN_BIN
    mean = np.bincount(place, residual, minlength=bins) / np.maximum(count, 1)
    left = float(np.sum((residual - mean[place]) ** 2))
    total = float(np.sum((residual - residual.mean()) ** 2))
    freedom = max(independent - int(used.sum()), 1.0)
    share = 1.0 - (left / max(total, 1.0e-300)) * max(independent - 1.0, 1.0) / freedom
    middle = 0.5 * (edges[1:] + edges[:-1])
    return Along(name, direction, middle[used], mean[used], min(max(share, 0.0), 1.0))


def inflation(residual: FloatArray) -> float:
    """Factor on all standard errors for residuals, shape (n,), that are larger than the noise or autocorrelated.

    The residuals are dimensionless. The square root of the largest ratio of the variance of means of pieces to that of
    independent samples; 1 where that is no more than chance.
    """
    largest = 1.0
    for length in _PIECES:
        pieces = residual.size // length
        if pieces < _FEWEST_PIECES:
            break
        sums = residual[: pieces * length].reshape(pieces, length).sum(axis=1)
        ratio = float(sums @ sums) / residual[: pieces * length].size
        if ratio > 1.0 + _SURE * math.sqrt(2.0 / pieces):
            largest = max(largest, ratio)
    return math.sqrt(largest)


def _correlation_length(residual: FloatArray) -> float:
    """Number of rows that count as one: 1 + 2 times the sum of autocorrelations up to their first zero."""
    centred = residual - residual.mean()
    size = 1 << (2 * residual.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: residual.size]
    if correlation[0] <= 0.0:
        return 1.0
    ratio = correlation / correlation[0]
    negative = np.flatnonzero(ratio < 0.0)
    end = int(negative[0]) if negative.size else residual.size
    return float(min(max(1.0 + 2.0 * float(ratio[1:end].sum()), 1.0), 0.25 * residual.size))
