"""The unknowns of the likelihood, as dimensionless coordinates with bounds and, where there is one, a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.samples import FloatArray


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One unknown: its coordinate is ln(value) where it is ``logarithmic``, else value / ``unit``.

    Bounds, ``prior`` and ``prior_sd`` (infinite: nothing is known beforehand) are in the coordinate itself.
    """

    name: str
    logarithmic: bool
    unit: float
    lower: float
    upper: float
    prior: float = 0.0
    prior_sd: float = math.inf

    def value(self, coordinate: float) -> float:
        """Return the value in its SI unit."""
        return math.exp(coordinate) if self.logarithmic else coordinate * self.unit

    def coordinate(self, value: float) -> float:
        """Return the coordinate of this value, within the bounds."""
        own = math.log(max(value, 1.0e-300)) if self.logarithmic else value / self.unit
        return min(max(own, self.lower), self.upper)

    def slope(self, coordinate: float) -> float:
        """Derivative of the value to the coordinate."""
        return math.exp(coordinate) if self.logarithmic else self.unit


def logarithmic(name: str, low: float, high: float, *, median: float = 1.0, sd: float = math.inf) -> Coordinate:
    """Return the unknown as its logarithm, between two values, with a lognormal prior."""
    return Coordinate(name, True, 1.0, math.log(low), math.log(high), math.log(median), sd)


def linear(
    name: str, unit: float, *, low: float = -math.inf, high: float = math.inf, centre: float = 0.0, sd: float = math.inf
) -> Coordinate:
    """Return the unknown in units of ``unit``; all other arguments are values in its SI unit."""
    return Coordinate(name, False, unit, low / unit, high / unit, centre / unit, sd / unit)


@dataclass(frozen=True, slots=True)
class Coordinates:
    """All unknowns of a fit, in order."""

    entries: tuple[Coordinate, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Their names in order."""
        return tuple(entry.name for entry in self.entries)

    @property
    def lower(self) -> FloatArray:
        """Lower bounds, shape (p,)."""
        return np.array([entry.lower for entry in self.entries])

    @property
    def upper(self) -> FloatArray:
        """Upper bounds, shape (p,)."""
        return np.array([entry.upper for entry in self.entries])

    @property
    def longest_step(self) -> FloatArray:
        """Longest step of a descent, shape (p,): a factor e of a logarithm, many units of what is linear."""
        return np.array([1.0 if entry.logarithmic or entry.name == "d" else 100.0 for entry in self.entries])

    @property
    def prior(self) -> FloatArray:
        """Means of the priors, shape (p,)."""
        return np.array([entry.prior for entry in self.entries])

    @property
    def prior_weight(self) -> FloatArray:
        """One over the variances of the priors, shape (p,); 0 where there is none."""
        return np.array([entry.prior_sd**-2 if math.isfinite(entry.prior_sd) else 0.0 for entry in self.entries])

    def values(self, point: FloatArray) -> dict[str, float]:
        """Return the values by name at this point, shape (p,)."""
        return {entry.name: entry.value(float(at)) for entry, at in zip(self.entries, point, strict=True)}

    def point(self, values: dict[str, float]) -> FloatArray:
        """Return the point, shape (p,), of values by name."""
        return np.array([entry.coordinate(values[entry.name]) for entry in self.entries])
