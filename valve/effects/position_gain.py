"""A position that reads too much or too little, in proportion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import IEC_61298, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PositionGain(Effect):
    """A position that reads too much or too little, in proportion."""

    cause: ClassVar[str] = "position_gain"
    equation: ClassVar[str] = "y = reference + (1 + error) (x - reference)"
    source: ClassVar[str] = IEC_61298
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "g", "1", "share by which the span reads too long", -0.2, 0.02, 0.2),
        EffectParameter(
            "reference_m", "x_r", "m", "where it reads right", 0.0, 0.0, 1.0, Per.TRAVEL, is_strength=False
        ),
    )

    error: float
    reference_m: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.sensor
        require_free(self.cause, slots, "gain")
        filled = replace(slots, gain=1.0 + self.error, gain_reference_m=self.reference_m)
        return replace(valve, sensor=filled)
