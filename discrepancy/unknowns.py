"""Unknowns of an extended valve by name: their coordinates, bounds and priors, and the valve that values make."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.samples import FloatArray
from valve.effects import EFFECTS
from valve.extended_valve import ExtendedValve
from valve.parameters import ValveParameters

VALVE_UNKNOWNS: Final = ("m", "k", "F_v", "F_c", "d", "F_0", "DV", "first_rise")
SEPARATOR: Final = "."
_BEGINNINGS: Final = ("x_", "v_")


@dataclass(frozen=True, slots=True)
class Unknown:
    """One unknown: ``unit`` is the size of its coordinate, 0 for the logarithm; ``step`` that of differences."""

    name: str
    lower: float
    upper: float
    unit: float = 0.0
    step: float = 1.0e-4
    prior: float = math.nan
    prior_sd: float = math.inf  # in the coordinate

    def coordinate(self, value: float) -> float:
        """Coordinate of a value."""
        return math.log(value) if self.unit == 0.0 else value / self.unit

    def value(self, coordinate: float) -> float:
        """Value at a coordinate."""
        return math.exp(coordinate) if self.unit == 0.0 else coordinate * self.unit


@dataclass(frozen=True, slots=True)
class Unknowns:
    """An ordered set of unknowns; a point is an array of their coordinates, shape (p,)."""

    entries: tuple[Unknown, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(entry.name for entry in self.entries)

    @property
    def lower(self) -> FloatArray:
        """Lower bounds, coordinates, shape (p,)."""
        return np.array([entry.coordinate(entry.lower) for entry in self.entries])

    @property
    def upper(self) -> FloatArray:
        """Upper bounds, coordinates, shape (p,)."""
        return np.array([entry.coordinate(entry.upper) for entry in self.entries])

    @property
    def steps(self) -> FloatArray:
        """Steps of differences, coordinates, shape (p,)."""
        return np.array([entry.step for entry in self.entries])

    def values(self, point: FloatArray) -> dict[str, float]:
        """Values by name at a point."""
        return {entry.name: entry.value(float(at)) for entry, at in zip(self.entries, point, strict=True)}

    def point(self, values: Mapping[str, float]) -> FloatArray:
        """Point of values by name, moved inside the bounds."""
        inside = [min(max(values[entry.name], entry.lower), entry.upper) for entry in self.entries]
        return np.array([entry.coordinate(value) for entry, value in zip(self.entries, inside, strict=True)])

    def prior_residuals(self, point: FloatArray) -> FloatArray:
        """Departures from the priors in their standard deviations, shape (p,); 0 where there is none."""
        off = np.zeros(point.size)
        for number, entry in enumerate(self.entries):
            if math.isfinite(entry.prior_sd):
                off[number] = (point[number] - entry.prior) / entry.prior_sd
        return off

    def prior_slopes(self) -> FloatArray:
        """Slope of each prior's residual, shape (p,)."""
        return np.array([1.0 / entry.prior_sd for entry in self.entries])

    def joined(self, more: Sequence[Unknown]) -> Unknowns:
        """Return these and more."""
        return Unknowns((*self.entries, *more))

    def below(self, name: str, upper: float) -> Unknowns:
        """Return these with an unknown that goes no higher than ``upper``, nor than it went."""
        return Unknowns(
            tuple(
                replace(entry, upper=min(entry.upper, max(upper, entry.lower))) if entry.name == name else entry
                for entry in self.entries
            )
        )


def of_a_segment(name: str) -> bool:
    """Whether an unknown is the position or the velocity at which a segment begins: it says nothing about the valve."""
    return name.startswith(_BEGINNINGS)


def valve_of(
    values: Mapping[str, float], causes: Sequence[str] = (), fixed: Mapping[str, float] | None = None
) -> ExtendedValve:
    """Return the valve that these values make: Karnopp's parameters and each cause's, named ``cause.parameter``.

    ``fixed`` holds parameters that are not fitted, named alike. Raises ParameterError where they are not physical.
    """
    everything = {**(fixed or {}), **values}
    parameters = ValveParameters(
        everything["m"],
        everything["k"],
        everything["F_v"],
        everything["F_c"],
        everything["F_c"] * (1.0 + everything["d"]),
        everything["DV"],
        everything["F_0"],
    )
    valve = ExtendedValve(parameters)
    for cause in causes:
        kind = EFFECTS[cause]
        own = {
            entry.name: everything[f"{cause}{SEPARATOR}{entry.name}"]
            for entry in kind.parameters
            if f"{cause}{SEPARATOR}{entry.name}" in everything
        }
        valve = kind(**own).apply(valve)
    first_rise = everything.get("first_rise", 0.0)
    return replace(valve, friction=replace(valve.friction, first_rise_n=first_rise)) if first_rise != 0.0 else valve
