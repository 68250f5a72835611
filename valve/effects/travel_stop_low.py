"""A seat, or something on it, inside the swept range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per, ValveScale
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class TravelStopLow(Effect):
    """A seat, or something on it, inside the swept range; ``rate_n_per_m`` 0: it does not give."""

    cause: ClassVar[str] = "travel_stop_low"
    equation: ClassVar[str] = "x >= stop; with a rate the stop pushes back by rate (stop - x) below it"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("position_m", "x_l", "m", "where it stops", -0.1, 0.05, 0.5, Per.TRAVEL),
        EffectParameter(
            "rate_n_per_m", "k_l", "N/m", "how hard it gives", 0.0, 0.0, 1.0e4, Per.RATE, is_strength=False
        ),
    )

    position_m: float
    rate_n_per_m: float = 0.0

    @classmethod
    def of_strength(cls, strength: float, scale: ValveScale, **shape: float) -> Self:
        """Return the stop at ``strength`` times 5 % of the travel; at 0 out of reach."""
        share = 0.05 * strength if strength != 0.0 else -1.0
        return cls(**{"position_m": share * scale.travel_m, **shape})

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        if self.position_m <= valve.stops.low_m:
            # the stop that is met first counts
            return valve
        rate_n_per_m = self.rate_n_per_m if self.rate_n_per_m != 0.0 else math.inf
        return replace(valve, stops=replace(valve.stops, low_m=self.position_m, low_rate_n_per_m=rate_n_per_m))
