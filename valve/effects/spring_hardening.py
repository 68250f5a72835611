"""A spring whose rate rises smoothly along the travel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class SpringHardening(Effect):
    """A spring whose rate rises smoothly along the travel."""

    cause: ClassVar[str] = "spring_hardening"
    equation: ClassVar[str] = "k x -> k x + h x^2/2"
    source: ClassVar[str] = "A. M. Wahl: Mechanical Springs, 2nd edition (1963)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "hardening_n_per_m2", "h", "N/m2", "rise of the rate per way", -0.3, 0.05, 0.6, Per.RATE_OVER_TRAVEL
        ),
    )

    hardening_n_per_m2: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.spring
        require_free(self.cause, slots, "hardening_n_per_m2")
        filled = replace(slots, hardening_n_per_m2=self.hardening_n_per_m2)
        return replace(valve, spring=filled)
