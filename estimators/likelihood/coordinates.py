"""The unknowns of the likelihood, as dimensionless coordinates with bounds and, where there is one, a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from estimators.samples import BoolArray, FloatArray


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


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """All unknowns of a fit, in order.

    ``names`` in that order; of shape (p,), in the coordinates: the bounds ``lower`` and ``upper``, the longest step of
    a descent (a factor e of a logarithm, many units of what is linear), the means of the priors, and one over their
    variances, 0 where there is none; and which of them are logarithms, and the units of those that are not.
    """

    entries: tuple[Coordinate, ...]
    names: tuple[str, ...] = field(init=False)
    lower: FloatArray = field(init=False)
    upper: FloatArray = field(init=False)
    longest_step: FloatArray = field(init=False)
    prior: FloatArray = field(init=False)
    prior_weight: FloatArray = field(init=False)
    logarithmic: BoolArray = field(init=False)
    unit: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        # they are asked for at each of some thousand simulations
        own = self.entries
        steps = [1.0 if entry.logarithmic or entry.name == "d" else 100.0 for entry in own]
        weights = [entry.prior_sd**-2 if math.isfinite(entry.prior_sd) else 0.0 for entry in own]
        for name, value in {
            "names": tuple(entry.name for entry in own),
            "lower": np.array([entry.lower for entry in own]),
            "upper": np.array([entry.upper for entry in own]),
            "longest_step": np.array(steps),
            "prior": np.array([entry.prior for entry in own]),
            "prior_weight": np.array(weights),
            "logarithmic": np.array([entry.logarithmic for entry in own], dtype=np.bool_),
            "unit": np.array([entry.unit for entry in own]),
        }.items():
            object.__setattr__(self, name, value)

    def values(self, point: FloatArray) -> dict[str, float]:
        """Return the values by name at this point, shape (p,)."""
        value = point * self.unit
        value[self.logarithmic] = np.exp(point[self.logarithmic])
        return dict(zip(self.names, value.tolist(), strict=True))

    def point(self, values: dict[str, float]) -> FloatArray:
        """Return the point, shape (p,), of values by name."""
        return np.array([entry.coordinate(values[entry.name]) for entry in self.entries])
