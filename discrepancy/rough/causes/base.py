"""What a cause is: the law that it adds with its natural ranges, shapes that are tried, its sentence and its action."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.setting import Setting
from estimators.base import NORMAL_95
from estimators.engine.laws import Law, LawParameter, Where
from valve.carried_digits import carried_places
from valve.effects import Effect
from valve.messages import UNITS, Message, say

FloatArray = npt.NDArray[np.float64]
Shape = tuple[float, ...]

_SMALL_STEP: Final = 1.0e-3  # of a parameter's spread beforehand


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted parameter with its standard error."""

    value: float
    std_error: float
    unit: str

    @property
    def ci95(self) -> tuple[float, float]:
        """Its 95 % interval."""
        return self.value - NORMAL_95 * self.std_error, self.value + NORMAL_95 * self.std_error

    def to_json(self) -> dict[str, Any]:
        """Return the parameter as in the analysis object."""
        return {"value": self.value, "unit": self.unit, "std_error": self.std_error, "ci95": list(self.ci95)}

    def in_words(self, unit: str, scale: float = 1.0) -> Message:
        """Return ``scale`` times the value in this unit, without sign, with its interval where it says more.

        It says more where the instrument knows better.
        """
        scale = -scale if self.value < 0.0 else scale
        value, (low, high) = scale * self.value, sorted(scale * end for end in self.ci95)
        in_si = UNITS[unit][1]
        places, is_shown = carried_places(value / in_si, 0.5 * (high - low) / in_si)
        digits = min(max(0, places), 6)
        if places < 0:
            value, low, high = (round(one / in_si, places) * in_si for one in (value, low, high))
        if not is_shown:
            return say("fitted_quantity", "{value:.{digits}f {unit}}", value=value, digits=digits, unit=unit)
        return say(
            "quantity_from_to",
            "{value:.{digits}f {unit}} ({low:.{digits}f in {unit}} to {high:.{digits}f in {unit}})",
            value=value,
            low=low,
            high=high,
            digits=digits,
            unit=unit,
        )


def parameter(
    name: str, unit: str, low: float, high: float, *, spread: float | None = None, mean: float = 0.0
) -> LawParameter:
    """Return a parameter of a law; without a ``spread`` nothing in its range is likelier than the rest."""
    if spread is None:
        mean, spread = 0.5 * (low + high), (high - low) / math.sqrt(12.0)
    return LawParameter(name, unit, low, high, mean, spread, mean, _SMALL_STEP * spread)


class Cause(Law, ABC):
    """A law, nearly linear in its first parameter, its size; the others are its shape (a place, a width, a time).

    ``setting`` holds the sizes of the valve that it is made for. ``known`` is the shape where that is no question, as
    of a cause that was accepted for the valve.
    """

    name: ClassVar[str]
    action: ClassVar[str]
    needs_spring: ClassVar[bool] = False
    is_offset: ClassVar[bool] = False  # known by what the nameplate says of the preload
    by_slips: ClassVar[bool] = True  # whether a stem shows it that hardly slides

    def __init__(self, setting: Setting, known: Shape | None = None) -> None:
        self.setting = setting
        self.known = known
        self.parameters = self.natural()

    @abstractmethod
    def natural(self) -> tuple[LawParameter, ...]:
        """Return the parameters with their natural ranges for this valve; the first is the size."""

    def shapes(self) -> list[Shape]:
        """Return the shapes that are tried, each as likely as the others beforehand."""
        return [()]

    def tried(self) -> list[Shape]:
        """Return the known shape alone, else all."""
        return self.shapes() if self.known is None else [self.known]

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:  # noqa: ARG002  - the default of every cause
        """Return as much as in motion: what place, time and pressure add is in F_c and F_s alike."""
        return self.friction_n(values, where)

    @abstractmethod
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes; ``short_n`` is by how much its F_s was raised to F_c.

        ``values``: shape (p,), SI.
        """

    @abstractmethod
    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told, with numbers."""

    def values(self, size: float, shape: Shape) -> FloatArray:
        """Return the values of the parameters in their order."""
        return np.array([size, *shape])
