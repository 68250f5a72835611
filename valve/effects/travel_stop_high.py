"""A stop inside the swept range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per, ValveScale
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class TravelStopHigh(Effect):
    """A stop inside the swept range: a limit screw, something in the body; ``rate_n_per_m`` 0: it does not give."""

    cause: ClassVar[str] = "travel_stop_high"
    equation: ClassVar[str] = "x <= stop; with a rate the stop pushes back by rate (x - stop) above it"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("position_m", "x_h", "m", "where it stops", 0.5, 0.95, 1.1, Per.TRAVEL),
        EffectParameter(
            "rate_n_per_m", "k_h", "N/m", "how hard it gives", 0.0, 0.0, 1.0e4, Per.RATE, is_strength=False
        ),
    )

    position_m: float
    rate_n_per_m: float = 0.0

    @classmethod
    def of_strength(cls, strength: float, scale: ValveScale, **shape: float) -> Self:
        """Return the stop at ``strength`` times 5 % of the travel below its end; at 0 out of reach."""
        share = 1.0 - 0.05 * strength if strength != 0.0 else 2.0
        return cls(**{"position_m": share * scale.travel_m, **shape})

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        if self.position_m >= valve.stops.high_m:
            # the stop that is met first counts
            return valve
        rate_n_per_m = self.rate_n_per_m if self.rate_n_per_m != 0.0 else math.inf
        return replace(valve, stops=replace(valve.stops, high_m=self.position_m, high_rate_n_per_m=rate_n_per_m))
