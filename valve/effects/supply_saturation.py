"""A pressure that cannot follow to the top."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per, ValveScale, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class SupplySaturation(Effect):
    """A pressure that cannot follow to the top: the air supply is low, the regulator set wrong."""

    cause: ClassVar[str] = "supply_saturation"
    equation: ClassVar[str] = "F_a <= limit, the diaphragm area times the supply pressure"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("limit_n", "F_max", "N", "actuator force at supply pressure", 0.4, 0.9, 1.1, Per.FULL_FORCE),
    )

    limit_n: float

    @classmethod
    def of_strength(cls, strength: float, scale: ValveScale, **shape: float) -> Self:
        """Return a limit that is ``strength`` times 10 % below the full force; at 0 out of reach."""
        share = 1.0 - 0.1 * strength if strength != 0.0 else 10.0
        return cls(**{"limit_n": share * scale.full_force_n, **shape})

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        require_free(self.cause, valve.input, "limit_n")
        return replace(valve, input=replace(valve.input, limit_n=self.limit_n))
