"""Units as people read them: SI with prefixes, bar and mm, or psi and inch; the values themselves stay SI."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from service.words.plain_numbers import plus_minus
from valve.messages import Message, Value
from valve.units import METRE_PER_INCH, PASCAL_PER_BAR, PASCAL_PER_PSI

#: The codes of messages that are one quantity.
QUANTITY: Final = "quantity"
MEASURED: Final = "measured"
_NEWTON_PER_POUND_FORCE: Final = 4.4482216152605  # NIST SP 811, table B.8, as the next
_KILOGRAM_PER_POUND: Final = 0.45359237


class UnitSystem(StrEnum):
    """What a person chose to read in."""

    SI = "si"
    BAR = "bar"
    PSI = "psi"

    @property
    def label(self) -> str:
        """What the switch calls it."""
        return {"si": "kPa, mm, N", "bar": "bar, mm, N", "psi": "psi, in, lbf"}[self.value]

    @classmethod
    def of(cls, name: str | None) -> UnitSystem:
        """Return the system of this name; SI for any other."""
        return cls(name) if name in list(cls) else cls.SI


@dataclass(frozen=True, slots=True)
class ShownUnit:
    """A unit to show and how many SI units it is."""

    name: str
    in_si: float

    def shown(self, value_si: float) -> float:
        """Return an SI value in this unit."""
        return value_si / self.in_si


_METRIC: Final[dict[str, ShownUnit]] = {
    "Pa": ShownUnit("kPa", 1.0e3),
    "Pa/s": ShownUnit("kPa/s", 1.0e3),
    "m": ShownUnit("mm", 1.0e-3),
    "m/s": ShownUnit("mm/s", 1.0e-3),
    "m2": ShownUnit("cm²", 1.0e-4),
    "N": ShownUnit("N", 1.0),
    "N/m": ShownUnit("N/mm", 1.0e3),
    "N*s/m": ShownUnit("N·s/mm", 1.0e3),
    "kg": ShownUnit("kg", 1.0),
}
_BAR: Final = {"Pa": ShownUnit("bar", PASCAL_PER_BAR), "Pa/s": ShownUnit("bar/s", PASCAL_PER_BAR)}
_PSI: Final = {
    "Pa": ShownUnit("psi", PASCAL_PER_PSI),
    "Pa/s": ShownUnit("psi/s", PASCAL_PER_PSI),
    "m": ShownUnit("in", METRE_PER_INCH),
    "m/s": ShownUnit("in/s", METRE_PER_INCH),
    "m2": ShownUnit("in²", METRE_PER_INCH**2),
    "N": ShownUnit("lbf", _NEWTON_PER_POUND_FORCE),
    "N/s": ShownUnit("lbf/s", _NEWTON_PER_POUND_FORCE),
    "N/m": ShownUnit("lbf/in", _NEWTON_PER_POUND_FORCE / METRE_PER_INCH),
    "N*s/m": ShownUnit("lbf·s/in", _NEWTON_PER_POUND_FORCE / METRE_PER_INCH),
    "kg": ShownUnit("lb", _KILOGRAM_PER_POUND),
}
_SYSTEMS: Final = {
    UnitSystem.SI: _METRIC,
    UnitSystem.BAR: {**_METRIC, **_BAR},
    UnitSystem.PSI: {**_METRIC, **_PSI},
}


def shown_unit(si_unit: str, system: UnitSystem) -> ShownUnit:
    """Return the unit in which a person reads a quantity of this SI unit; others (s, %) are shown as they are."""
    return _SYSTEMS[system].get(si_unit, ShownUnit({"percent": "%", "1": ""}.get(si_unit, si_unit), 1.0))


def quantity(value_si: float | None, si_unit: str, system: UnitSystem, digits: int = 4) -> str:
    """A value that was set, with its unit, such as ``82.74 kPa``; a dash where there is none."""
    if value_si is None:
        return "–"
    unit = shown_unit(si_unit, system)
    return f"{plus_minus(unit.shown(value_si), None, digits=digits)} {unit.name}".rstrip()


def measured(
    value_si: float | None, ci95: list[float] | tuple[float, float] | None, si_unit: str, system: UnitSystem
) -> str:
    """A measured value with half of its 95 % interval and its unit, ``510.0 ± 1.2 N``; a dash where it is None.

    The digits are those that interval and instrument carry: ``50.7 N`` where the interval is narrower than these.
    """
    if value_si is None:
        return "–"
    unit = shown_unit(si_unit, system)
    half = None if ci95 is None else unit.shown(max(ci95[1] - value_si, value_si - ci95[0]))
    return f"{plus_minus(unit.shown(value_si), half)} {unit.name}".rstrip()


def quantity_said(value_si: float | None, si_unit: str, digits: int = 4) -> Message:
    """``quantity`` as a part of a message: each reader has it in their units."""
    text = quantity(value_si, si_unit, UnitSystem.SI, digits)
    values: dict[str, Value] = {}
    if value_si is not None:
        values = {"value": float(value_si), "unit": si_unit, "digits": digits}
    return Message(QUANTITY, text.replace("{", "{{"), values)


def measured_said(value_si: float | None, ci95: list[float] | tuple[float, float] | None, si_unit: str) -> Message:
    """``measured`` as a part of a message: each reader has it in their units."""
    text = measured(value_si, ci95, si_unit, UnitSystem.SI)
    values: dict[str, Value] = {} if value_si is None else {"value": float(value_si), "unit": si_unit}
    if value_si is not None and ci95 is not None:
        values |= {"low": float(ci95[0]), "high": float(ci95[1])}
    return Message(MEASURED, text.replace("{", "{{"), values)


def said_in(message: Message, system: UnitSystem) -> str | None:
    """Return what ``quantity_said`` or ``measured_said`` made in the units of ``system``; None for another message."""
    values: dict[str, Any] = dict(message.values)
    if message.code == QUANTITY:
        return quantity(values.get("value"), values.get("unit", ""), system, values.get("digits", 4))
    if message.code != MEASURED:
        return None
    ci95 = (values["low"], values["high"]) if "low" in values else None
    return measured(values.get("value"), ci95, values.get("unit", ""), system)
