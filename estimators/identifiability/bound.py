"""What a test can tell: the Cramér-Rao bound of each parameter, and which parameters are tied to each other.

One definition for a test that is planned and for one that was done: both give their Fisher information.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.base import LARGEST_RELATIVE_HALF_WIDTH, NORMAL_95
from estimators.identifiability.tie_search import find_tie, lone_reason
from estimators.identifiability.ties import Quantities, Tie
from estimators.samples import FloatArray

# Below this the scaled information is rounding of the differences that it was made of (1e-7 squared, and to spare).
_LEAST_EIGENVALUE: Final = 1.0e-12
# A direction without information takes those with it whose share of it is above its own rounding.
_LEAST_SHARE: Final = 1.0e-10


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What is known of ``symbols`` at ``values``: ``covariance``, shape (p, p), SI units.

    Where the information is singular the covariance is very large, not infinite, so that combinations which are
    known can be computed from it; ``undetermined`` names the symbols that it says nothing of.
    """

    symbols: tuple[str, ...]
    values: tuple[float, ...]
    covariance: FloatArray
    undetermined: frozenset[str] = frozenset()
    sliding_speeds_m_per_s: tuple[float, ...] = ()
    ramp_rates_n_per_s: tuple[float, ...] = ()
    _ties: dict[str, Tie | None] = field(default_factory=dict, repr=False)

    def value(self, symbol: str) -> float:
        """Return the value at which the bound was taken, SI."""
        return self.values[self.symbols.index(symbol)]

    def std_error(self, symbol: str) -> float:
        """Return the standard error of this symbol, all others unknown too, SI; infinite where nothing is known."""
        if symbol in self.undetermined:
            return math.inf
        place = self.symbols.index(symbol)
        return math.sqrt(float(self.covariance[place, place]))

    def relative(self, symbol: str) -> float:
        """Return half the width of the 95 % interval as a share of the value.

        F_0 may be 0: its share is taken of F_c where that is larger.
        """
        size = abs(self.value(symbol))
        if symbol == "F_0" and "F_c" in self.symbols:
            size = max(size, abs(self.value("F_c")))
        half_width = NORMAL_95 * self.std_error(symbol)
        return half_width / size if size > 0.0 else math.inf

    def identifiable(self, symbol: str) -> bool:
        """Whether the 95 % interval is within +-30 %."""
        return self.relative(symbol) <= LARGEST_RELATIVE_HALF_WIDTH

    def ties(self, symbol: str) -> Tie | None:
        """Return what this symbol is tied to, where that is why it is not identifiable; None otherwise."""
        if self.identifiable(symbol):
            return None
        if symbol not in self._ties:
            self._ties[symbol] = find_tie(symbol, self._quantities)
        return self._ties[symbol]

    @property
    def _quantities(self) -> Quantities:
        return Quantities(
            self.symbols, self.values, self.covariance, self.sliding_speeds_m_per_s, self.ramp_rates_n_per_s
        )

    def note(self, symbol: str) -> str:
        """Return why this symbol is not identifiable, what is known instead and what would help; "" if it is.

        It reads on from "known to +-80 % only: " (``estimators.base.measured``).
        """
        if self.identifiable(symbol):
            return ""
        tie = self.ties(symbol)
        return lone_reason(symbol, self._quantities) if tie is None else tie.sentence


def knowledge(
    symbols: Sequence[str],
    values: Sequence[float],
    information: FloatArray,
    *,
    sliding_speeds_m_per_s: Sequence[float] = (),
    ramp_rates_n_per_s: Sequence[float] = (),
) -> Knowledge:
    """Turn a Fisher information, shape (p, p), SI, into what is known; it may be singular.

    ``symbols`` are the model's and those of the nuisances that were fitted with them; known priors stand in the
    information. The speeds at which the stem slid and the rates of the force put the ties into words.
    Raises ValueError where the information does not fit the symbols or is not finite.
    """
    p = len(symbols)
    if information.shape != (p, p) or len(values) != p or not np.isfinite(information).all():
        raise ValueError(f"information of shape {information.shape} for {p} symbols: give finite numbers, one row each")
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    size[size == 0.0] = 1.0
    # scaled to a unit diagonal first: kg, N/m and m/s differ by ten orders of magnitude
    weights, directions = np.linalg.eigh(0.5 * (information + information.T) / np.outer(size, size))
    empty = weights < _LEAST_EIGENVALUE
    variances = 1.0 / np.maximum(weights, _LEAST_EIGENVALUE)
    shares = np.square(directions[:, empty]).sum(axis=1)
    covariance = (directions * variances) @ directions.T / np.outer(size, size)
    return Knowledge(
        tuple(symbols),
        tuple(float(value) for value in values),
        covariance,
        frozenset(symbol for symbol, share in zip(symbols, shares, strict=True) if share > _LEAST_SHARE),
        tuple(sliding_speeds_m_per_s),
        tuple(ramp_rates_n_per_s),
    )
