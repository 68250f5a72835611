"""An effective diaphragm area that changes along the travel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class DiaphragmAreaChange(Effect):
    """An effective diaphragm area that changes along the travel."""

    cause: ClassVar[str] = "diaphragm_area_change"
    equation: ClassVar[str] = "S_a -> S_a (1 + b (x - reference))"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "slope_per_m", "b", "1/m", "relative change of the area per way", -0.3, -0.04, 0.3, Per.ONE_OVER_TRAVEL
        ),
        EffectParameter(
            "reference_m", "x_r", "m", "where the nameplate's area holds", 0.0, 0.5, 1.0, Per.TRAVEL, is_strength=False
        ),
    )

    slope_per_m: float
    reference_m: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.area
        require_free(self.cause, slots, "slope_per_m")
        filled = replace(slots, slope_per_m=self.slope_per_m, reference_m=self.reference_m)
        return replace(valve, area=filled)
