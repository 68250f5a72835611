"""The nameplate: what is known of a valve before it is measured. Nested as in its TOML file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from valve.errors import ParameterError, refuse
from valve.messages import say
from valve.units import linear


class Action(StrEnum):
    """What drives the stem back."""

    SPRING = "spring"
    DOUBLE = "double"


def _not_positive(key: str, value: float | None, unit: str) -> str:
    if value is None or (math.isfinite(value) and value > 0.0):
        return ""
    return say(
        "nameplate_not_positive",
        "{key} is {value:g} {unit}, it must be above 0: correct the nameplate",
        key=key,
        value=value,
        unit=unit,
    )


def _no_range(key: str, span: Sequence[float], unit: str) -> str:
    if len(span) != 2:
        return say(
            "range_of_two",
            "{key} has {count} values, it needs 2: give its lower and its upper end",
            key=key,
            count=len(span),
        )
    low, high = span
    if math.isfinite(low) and math.isfinite(high) and low < high:
        return ""
    return say(
        "range_must_rise",
        "{key} is {low:g} to {high:g} {unit}, it must rise: give the lower value first",
        key=key,
        low=low,
        high=high,
        unit=unit,
    )


def _action(value: str) -> Action:
    try:
        return Action(value)
    except ValueError:
        raise ParameterError(
            say(
                "action_unknown",
                "actuator.action is {value}, there are {actions:, }: choose one",
                value=repr(value),
                actions=tuple(Action),
            )
        ) from None


@dataclass(frozen=True, slots=True)
class Actuator:
    """The pneumatic (or other) actuator; lengths in m, pressures in Pa, mass in kg.

    Raises ParameterError where a value is not physical.
    """

    travel_m: float
    diaphragm_area_m2: float | None = None
    action: Action = Action.SPRING
    moving_mass_kg: float | None = None
    bench_set_pa: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "action", _action(self.action))
        faults = [
            _not_positive("actuator.travel_m", self.travel_m, "m"),
            _not_positive("actuator.diaphragm_area_m2", self.diaphragm_area_m2, "m2"),
            _not_positive("actuator.moving_mass_kg", self.moving_mass_kg, "kg"),
        ]
        if self.bench_set_pa is not None:
            object.__setattr__(self, "bench_set_pa", tuple(self.bench_set_pa))  # whatever sequence a file gave
            faults.append(_no_range("actuator.bench_set_pa", self.bench_set_pa, "Pa"))
            if self.action is Action.DOUBLE:
                faults.append(
                    say(
                        "bench_set_without_spring",
                        "{key} is given for a double-acting actuator, which has no spring: leave it out",
                        key="actuator.bench_set_pa",
                    )
                )
        refuse(ParameterError, faults)


@dataclass(frozen=True, slots=True)
class Signal:
    """The I/P transducer: the current that it takes (mA) and the pressure that it gives (Pa).

    Raises ParameterError where a range does not rise.
    """

    range_ma: tuple[float, float]
    range_pa: tuple[float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "range_ma", tuple(self.range_ma))
        object.__setattr__(self, "range_pa", tuple(self.range_pa))
        faults = _no_range("signal.range_ma", self.range_ma, "mA"), _no_range("signal.range_pa", self.range_pa, "Pa")
        refuse(ParameterError, faults)

    def pressure_pa(self, current_ma: float) -> float:
        """Pressure that the transducer should give at this current, Pa."""
        return linear(current_ma, self.range_ma, self.range_pa)

    def current_ma(self, pressure_pa: float) -> float:
        """Current that asks for this pressure, mA."""
        return linear(pressure_pa, self.range_pa, self.range_ma)


@dataclass(frozen=True, slots=True)
class Nameplate:
    """A valve's nameplate: ``tag``, ``[actuator]`` and, where there is an I/P, ``[signal]``.

    Raises ParameterError for a tag that cannot be shown.
    """

    tag: str
    actuator: Actuator
    signal: Signal | None = None

    def __post_init__(self) -> None:
        if not self.tag or len(self.tag) > 64 or not self.tag.isprintable():
            raise ParameterError(
                say("tag_not_printable", "tag {tag}: give 1 to 64 printable characters", tag=repr(self.tag))
            )

    @property
    def nominal_preload_n(self) -> float | None:
        """Preload that the bench set implies, N: S_a times its lower pressure; None where unknown."""
        area_m2, bench_set_pa = self.actuator.diaphragm_area_m2, self.actuator.bench_set_pa
        return None if area_m2 is None or bench_set_pa is None else area_m2 * bench_set_pa[0]

    @property
    def nominal_spring_rate_n_per_m(self) -> float | None:
        """Spring rate that the bench set and the travel imply, N/m; None where unknown."""
        area_m2, bench_set_pa = self.actuator.diaphragm_area_m2, self.actuator.bench_set_pa
        if area_m2 is None or bench_set_pa is None:
            return None
        return area_m2 * (bench_set_pa[1] - bench_set_pa[0]) / self.actuator.travel_m
