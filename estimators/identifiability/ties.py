"""Ties: parameters that a test cannot tell apart, and what is known of them together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.samples import FloatArray
from valve.messages import Message, say

INPUT_TIMES: Final = ("transducer_lag_s", "transducer_dead_time_s", "delay_s")
_NAMES: Final = {
    "transducer_lag_s": say("lag_of_transducer", "the transducer's lag"),
    "transducer_dead_time_s": say("dead_time_of_transducer", "the transducer's dead time"),
    "delay_s": say("delay_between_channels", "the delay between the channels"),
    "x_0": say("position_at_start", "the position at the start"),
}


@dataclass(frozen=True, slots=True)
class Tie:
    """Parameters that the data know only together.

    ``combination`` is what is known instead, a formula in the paper's symbols, with its ``meaning``, ``value`` and
    ``std_error`` in ``unit``. ``symbols`` are two, more where only several together explain it; ``correlation`` is
    that of the first with the others.
    """

    symbols: tuple[str, ...]
    correlation: float
    combination: str
    value: float
    std_error: float
    unit: str
    separated_by: str
    meaning: str = ""

    @property
    def sentence(self) -> Message:
        """What a technician is told."""
        formula = self.combination
        return say(
            "cannot_be_told_apart",
            "it cannot be told apart from {others: and }; what is known is {what} = {value:.5g {unit}} "
            "(+-{half:.2g in {unit}}); {remedy}",
            others=tuple(_NAMES.get(symbol, symbol) for symbol in self.symbols[1:]),
            what=say("meaning_with_formula", "{meaning}, {formula}", meaning=self.meaning, formula=formula)
            if self.meaning
            else formula,
            value=self.value,
            unit=self.unit,
            half=NORMAL_95 * self.std_error,
            remedy=self.separated_by,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Quantities:
    """The symbols with values and covariance, shape (p, p), and the speeds and rates of the test."""

    symbols: tuple[str, ...]
    values: tuple[float, ...]
    covariance: FloatArray
    sliding_speeds_m_per_s: tuple[float, ...]
    ramp_rates_n_per_s: tuple[float, ...]

    def value(self, symbol: str) -> float:
        """Return the value of a symbol, SI."""
        return self.values[self.symbols.index(symbol)]

    def best(self, lead: str, partners: Sequence[str]) -> tuple[FloatArray, float, float]:
        """Return the weights w, shape (n_partners,), of the best known lead + w . partners, its error, and R.

        w = -S_pp^-1 S_pl minimises the variance; R is the multiple correlation of the lead with the partners.
        """
        row, columns = self.symbols.index(lead), [self.symbols.index(partner) for partner in partners]
        # scaled, so that a solve over kg and N/m keeps its digits
        size = np.sqrt(np.diag(self.covariance))
        scaled = self.covariance / np.outer(size, size)
        weights = -np.linalg.lstsq(scaled[np.ix_(columns, columns)], scaled[columns, row], rcond=1.0e-14)[0]
        every = np.append(weights, 1.0)
        order = [*columns, row]
        left = min(max(float(every @ scaled[np.ix_(order, order)] @ every), 0.0), 1.0)
        return weights * size[row] / size[columns], math.sqrt(left) * float(size[row]), math.sqrt(1.0 - left)

    def error(self, gradient: Mapping[str, float]) -> float:
        """Return the standard error of a combination with these derivatives to the symbols."""
        slopes = np.array([gradient.get(symbol, 0.0) for symbol in self.symbols])
        return math.sqrt(max(float(slopes @ self.covariance @ slopes), 0.0))

    def correlation(self, first: str, second: str) -> float:
        """Return the correlation of two symbols."""
        i, j = self.symbols.index(first), self.symbols.index(second)
        return float(self.covariance[i, j] / math.sqrt(self.covariance[i, i] * self.covariance[j, j]))
