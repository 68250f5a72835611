"""What an effect is: a cause by its name, its parameters with unit and range, and the slot that it fills."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Final, Self

from valve.errors import ParameterError
from valve.extended_valve import ExtendedValve, FrictionSlots, require_finite
from valve.messages import say
from valve.parameters import ValveParameters

ARMSTRONG: str = (
    "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit: A survey of models, analysis tools and compensation methods "
    "for the control of machines with friction, Automatica 30 (1994) 1083-1138"
)
IEC_61298: str = "IEC 61298-2:2008, Process measurement and control devices: tests under reference conditions"
HANDBOOK: str = "Emerson: Control Valve Handbook, 5th edition"


class Per(StrEnum):
    """What a range is given in shares of, so that it suits a small valve and a large one."""

    ONE = "1"
    FRICTION = "F_c"
    FULL_FORCE = "force at full pressure"
    TRAVEL = "travel"
    FRICTION_OVER_TRAVEL = "F_c/travel"
    FRICTION_OVER_TRAVEL_SQUARED = "F_c/travel^2"
    RATE = "k"
    RATE_OVER_TRAVEL = "k/travel"
    RATE_OVER_TRAVEL_SQUARED = "k/travel^2"
    ONE_OVER_TRAVEL = "1/travel"


@dataclass(frozen=True, slots=True)
class ValveScale:
    """Sizes of one valve, SI: what is much and little in it."""

    travel_m: float
    full_force_n: float
    friction_n: float
    spring_rate_n_per_m: float

    def __post_init__(self) -> None:
        for entry in fields(self):
            if not getattr(self, entry.name) > 0.0:
                raise ParameterError(
                    say(
                        "value_not_positive",
                        "{name} is {value:g}, it must be above 0: correct it",
                        name=entry.name,
                        value=getattr(self, entry.name),
                    )
                )

    @classmethod
    def of(cls, parameters: ValveParameters, travel_m: float, full_force_n: float) -> Self:
        """Return the sizes of a valve; without friction or spring a percent of the full force stands for them."""
        friction_n = max(parameters.coulomb_friction_n, 0.001 * full_force_n)
        rate_n_per_m = parameters.spring_rate_n_per_m or full_force_n / travel_m
        return cls(travel_m, full_force_n, friction_n, rate_n_per_m)

    def unit(self, per: Per) -> float:
        """Return the size, SI, that a range is given in shares of."""
        return {
            Per.ONE: 1.0,
            Per.FRICTION: self.friction_n,
            Per.FULL_FORCE: self.full_force_n,
            Per.TRAVEL: self.travel_m,
            Per.FRICTION_OVER_TRAVEL: self.friction_n / self.travel_m,
            Per.FRICTION_OVER_TRAVEL_SQUARED: self.friction_n / self.travel_m**2,
            Per.RATE: self.spring_rate_n_per_m,
            Per.RATE_OVER_TRAVEL: self.spring_rate_n_per_m / self.travel_m,
            Per.RATE_OVER_TRAVEL_SQUARED: self.spring_rate_n_per_m / self.travel_m**2,
            Per.ONE_OVER_TRAVEL: 1.0 / self.travel_m,
        }[per]


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One parameter of an effect. ``low``, ``typical`` and ``high`` are shares of ``per``.

    A strength has its neutral value at 0, where the effect is not there; the rest is shape.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    low: float
    typical: float
    high: float
    per: Per = Per.ONE
    is_strength: bool = True

    def range(self, scale: ValveScale) -> tuple[float, float]:
        """Lowest and highest value that is physically plausible for this valve, in ``unit``."""
        size = scale.unit(self.per)
        return self.low * size, self.high * size


STATIC_SHARE: Final = EffectParameter(
    "static_share", "q", "1", "share of it by which F_s changes", 0.0, 1.0, 3.0, is_strength=False
)


@dataclass(frozen=True, slots=True)
class Effect(ABC):
    """A departure from the Karnopp valve. Raises ParameterError where a number is not finite or not physical."""

    cause: ClassVar[str]
    equation: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]

    def __post_init__(self) -> None:
        for name, value in self.values().items():
            if not math.isfinite(value):
                require_finite(say("parameter_of_cause", "{cause}: {name}", cause=self.cause, name=name), value)

    @abstractmethod
    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it, beside what it has. Raises ParameterError where both cannot be."""

    @classmethod
    def of_strength(cls, strength: float, scale: ValveScale, **shape: float) -> Self:
        """Return the effect at ``strength`` times its typical size, 0 for none, with typical or given shape.

        Raises ParameterError for a name that the effect has not.
        """
        values = {
            entry.name: entry.typical * scale.unit(entry.per) * (strength if entry.is_strength else 1.0)
            for entry in cls.parameters
        }
        unknown = sorted(set(shape) - set(values))
        if unknown:
            raise ParameterError(
                say(
                    "effect_parameter_unknown",
                    "{cause}: {parameter}: no such parameter; there are {known:, }",
                    cause=cls.cause,
                    parameter=unknown[0],
                    known=tuple(values),
                )
            )
        return cls(**{**values, **shape})

    def values(self) -> dict[str, float]:
        """Return its parameters by name."""
        return {entry.name: float(getattr(self, entry.name)) for entry in self.parameters}


def require_free(cause: str, slots: Any, *names: str) -> None:
    """Raise ParameterError where one of these fields of a group of slots is filled already."""
    neutral = type(slots)()
    for name in names:
        if getattr(slots, name) != getattr(neutral, name):
            raise ParameterError(
                say(
                    "slot_taken",
                    "{cause}: {name} is {value:g} already, one valve has one: drop one",
                    cause=cause,
                    name=name,
                    value=getattr(slots, name),
                )
            )


def with_static_share(cause: str, slots: FrictionSlots, share: float) -> FrictionSlots:
    """Return the slots with this share of what is added to the friction in F_s.

    Raises ParameterError where another effect has another share.
    """
    if 1.0 not in {slots.static_share, share} and share != slots.static_share:
        raise ParameterError(
            say(
                "static_share_differs",
                "{cause}: static_share is {share:g}, and {before:g} already: give both effects the same",
                cause=cause,
                share=share,
                before=slots.static_share,
            )
        )
    return replace(slots, static_share=share if slots.static_share == 1.0 else slots.static_share)
