"""Whether a fit explains all that was measured: its residuals against the noise, as a whole and piece by piece."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.samples import BoolArray, FloatArray

# Own choices, from fits at the right and at wrong optima of random valves.
LARGEST_RATIO: Final = 1.2
_LARGEST_PIECE: Final = 6.5  # standard deviations of the mean of a piece, beyond what the most of them reach
_LARGEST_KINSHIP: Final = 5.0  # below 3 where the fit was right, in coverage and random valves; 5.9 where it was not
_LARGEST_UNEVENNESS: Final = 6.0
_NEAR_RATIO: Final = 1.5
_NEAR_PIECE: Final = 15.0
_PIECES: Final = (3, 10, 30, 100, 300)
_SHORT_PIECES: Final = (2, 4, 8, 16, 32)
_FEWEST_PIECES: Final = 30


@dataclass(frozen=True, slots=True)
class Certificate:
    """``ratio``: rms residual over noise; ``piece``: the largest mean of a piece, in its standard deviations.

    ``kinship``: how much more the means of short pieces scatter than those of white residuals of the same size, in
    standard deviations. ``unevenness``: how much more the residuals of rows in which the position bends scatter than
    those of all others, likewise. A wrong optimum whose misfit hides in the noise's own uncertainty shows in both.
    """

    ratio: float
    piece: float
    rows: int
    kinship: float = 0.0
    unevenness: float = 0.0

    @property
    def is_even(self) -> bool:
        """Whether the residuals are as white where the stem accelerates as elsewhere, whatever their size."""
        return self.kinship <= _LARGEST_KINSHIP and self.unevenness <= _LARGEST_UNEVENNESS

    @property
    def is_good(self) -> bool:
        """Whether noise alone explains the residuals."""
        return self.ratio <= LARGEST_RATIO and self.piece <= _LARGEST_PIECE and self.is_even

    @property
    def is_near(self) -> bool:
        """Whether what noise does not explain is so little that wider intervals may hold it."""
        return self.ratio <= _NEAR_RATIO and self.piece <= _NEAR_PIECE and self.is_even


def certify(residual: FloatArray, weight: FloatArray, bends: BoolArray | None = None) -> Certificate:
    """Judge residuals in standard deviations, shape (n,); rows of weight 0 do not count; ``bends``: see above."""
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
    if np.ptp(weight[weight > 0.0]) > 0.0:
        return Certificate(ratio, largest, own.size)  # a sensor's grid, whose errors are not white
    unevenness = 0.0 if bends is None else _unevenness(own, bends[weight > 0.0])
    return Certificate(ratio, largest, own.size, _kinship(own), unevenness)


def _unevenness(own: FloatArray, bends: BoolArray) -> float:
    """Excess of the variance of the rows that bend over the others', in standard deviations of chance."""
    bent, calm = own[bends], own[~bends]
    if min(bent.size, calm.size) < _FEWEST_PIECES or not calm.any():
        return 0.0
    ratio = float(np.mean(bent * bent) / np.mean(calm * calm))
    return (ratio - 1.0) / math.sqrt(2.0 / bent.size + 2.0 / calm.size)


def _kinship(own: FloatArray) -> float:
    """The largest excess of the variance of sums of neighbours, shape (n,), in standard deviations of chance."""
    variance, largest = float(own @ own) / own.size, 0.0
    for length in _SHORT_PIECES:
        pieces = own.size // length
        if pieces < _FEWEST_PIECES or variance == 0.0:
            break
        sums = own[: pieces * length].reshape(pieces, length).sum(axis=1)
        excess = float(sums @ sums) / (pieces * length * variance) - 1.0
        largest = max(largest, excess / math.sqrt(2.0 / pieces))
    return largest
