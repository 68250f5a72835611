"""A spring whose rate changes at a knee: a second spring meets, coils close."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class DualRateSpring(Effect):
    """A spring whose rate changes at a knee: a second spring meets, coils close."""

    cause: ClassVar[str] = "dual_rate_spring"
    equation: ClassVar[str] = "k x -> k x + dk max(x - knee, 0)"
    source: ClassVar[str] = "A. M. Wahl: Mechanical Springs, 2nd edition (1963)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "rate_change_n_per_m", "dk", "N/m", "change of the rate beyond the knee", -0.5, 0.1, 1.0, Per.RATE
        ),
        EffectParameter("knee_m", "x_k", "m", "where it changes", 0.05, 0.5, 0.95, Per.TRAVEL, is_strength=False),
    )

    rate_change_n_per_m: float
    knee_m: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.spring
        require_free(self.cause, slots, "knee_rate_n_per_m")
        filled = replace(slots, knee_rate_n_per_m=self.rate_change_n_per_m, knee_m=self.knee_m)
        return replace(valve, spring=filled)
