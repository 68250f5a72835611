"""Means over repeated passes, with errors that hold both the noise and what differs from cycle to cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import chdtri

from estimators.base import student_95
from estimators.samples import FloatArray

_SURELY_MORE: Final = 0.05  # own choice: chance at which noise alone passes for a difference between cycles
_MANY: Final = 1.0e9  # degrees of freedom from which Student's distribution is the normal one


@dataclass(frozen=True, slots=True)
class Measured:
    """A value, its standard error and the degrees of freedom that the error is known with."""

    value: float
    std_error: float
    freedom: float = _MANY

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval, by Student's distribution."""
        return student_95(self.freedom) * self.std_error

    def scaled(self, factor: float) -> Measured:
        """The same in another unit."""
        return Measured(factor * self.value, abs(factor) * self.std_error, self.freedom)

    def with_error(self, more: float) -> Measured:
        """The same with one more error, independent of the first and known well."""
        return combined(self.value, (self, 1.0), (Measured(0.0, more), 1.0))


def combined(value: float, *parts: tuple[Measured, float]) -> Measured:
    """``value`` with the errors of independent parts, each with its weight; freedom by Welch and Satterthwaite."""
    variances = [(weight * part.std_error) ** 2 for part, weight in parts]
    total = sum(variances)
    if total <= 0.0:
        return Measured(value, 0.0)
    shares = sum((variance / total) ** 2 / part.freedom for variance, (part, _) in zip(variances, parts, strict=True))
    return Measured(value, math.sqrt(total), min(_MANY, 1.0 / shares))


def mean_of_cycles(values: FloatArray, std_error: float, freedom: float) -> Measured:
    """Mean of values, shape (n,), any unit, of which noise explains ``std_error`` each.

    Where they differ by more than noise does (chi-square test at 5 %), their own scatter takes its place:
    s / sqrt(n) with n - 1 degrees of freedom.
    """
    count = values.size
    mean = float(values.mean())
    if count > 1:
        scatter = float(values.std(ddof=1))
        limit = float(chdtri(count - 1, _SURELY_MORE)) / (count - 1)
        if scatter**2 > limit * std_error**2:
            return Measured(mean, scatter / math.sqrt(count), count - 1.0)
    return Measured(mean, std_error / math.sqrt(count), freedom)


def noise_of_cells(cells: FloatArray) -> tuple[float, float]:
    """Standard deviation of one cell's mean and its degrees of freedom, from cells, N, shape (n_passes, n_cells).

    By second differences along the travel, which leave out what bends slowly: var = mean(d2^2) / 6.
    """
    second = np.diff(cells, 2, axis=1)
    if second.size == 0:
        return math.nan, 1.0
    # neighbours among second differences are correlated (-2/3, 1/6): 1 / (1 + 2 (4/9 + 1/36)) of them are free
    return math.sqrt(float(np.mean(second**2)) / 6.0), max(1.0, second.size / 1.94)
