"""Whether a fit explains all that was measured: its residuals against the noise, as a whole and piece by piece."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.samples import FloatArray

# Own choices, from fits at the right and at wrong optima of random valves.
LARGEST_RATIO: Final = 1.2
_LARGEST_PIECE: Final = 6.5  # standard deviations of the mean of a piece, beyond what the most of them reach
_NEAR_RATIO: Final = 1.5
_NEAR_PIECE: Final = 15.0
_PIECES: Final = (3, 10, 30, 100, 300)


@dataclass(frozen=True, slots=True)
class Certificate:
    """``ratio``: rms residual over noise; ``piece``: the largest mean of a piece, in its standard deviations."""

    ratio: float
    piece: float
    rows: int

    @property
    def is_good(self) -> bool:
        """Whether noise alone explains the residuals."""
        return self.ratio <= LARGEST_RATIO and self.piece <= _LARGEST_PIECE

    @property
    def is_near(self) -> bool:
        """Whether what noise does not explain is so little that wider intervals may hold it."""
        return self.ratio <= _NEAR_RATIO and self.piece <= _NEAR_PIECE


def certify(residual: FloatArray, weight: FloatArray) -> Certificate:
    """Judge residuals in standard deviations, shape (n,); rows of weight 0 do not count."""
    own = residual[weight > 0.0]
    if own.size == 0:
        return Certificate(math.inf, math.inf, 0)
    ratio = math.sqrt(float(own @ own) / own.size)
    largest = 0.0
    for length in _PIECES:
        pieces = own.size // length
        if pieces < 2:
            break
        sums = own[: pieces * length].reshape(pieces, length).sum(axis=1)
        expected = math.sqrt(2.0 * math.log(pieces)) - 3.0
        largest = max(largest, float(np.abs(sums).max()) / math.sqrt(length) - max(0.0, expected))
    return Certificate(ratio, largest, own.size)
