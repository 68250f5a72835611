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
    equation: ClassVar[str] = "k x -> k x + h x^2/2 + c (x^3/6 - middle x^2/2)"
    source: ClassVar[str] = "A. M. Wahl: Mechanical Springs, 2nd edition (1963)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "hardening_n_per_m2", "h", "N/m2", "rise of the rate per way", -0.3, 0.05, 0.6, Per.RATE_OVER_TRAVEL
        ),
        EffectParameter(
            "bend_n_per_m3",
            "c",
            "N/m3",
            "by how much more it rises farther out",
            -2.0,
            0.0,
            2.0,
            Per.RATE_OVER_TRAVEL_SQUARED,
            is_strength=False,
        ),
        EffectParameter("middle_m", "x_m", "m", "where h is the rise", 0.0, 0.5, 1.0, Per.TRAVEL, is_strength=False),
    )

    hardening_n_per_m2: float
    bend_n_per_m3: float = 0.0
    middle_m: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.spring
        require_free(self.cause, slots, "hardening_n_per_m2")
        filled = replace(
            slots,
            hardening_n_per_m2=self.hardening_n_per_m2,
            hardening_bend_n_per_m3=self.bend_n_per_m3,
            hardening_middle_m=self.middle_m,
        )
        return replace(valve, spring=filled)
