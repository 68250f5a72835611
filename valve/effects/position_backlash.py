"""Lost motion between the stem and the position sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import IEC_61298, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PositionBacklash(Effect):
    """Lost motion between the stem and the position sensor."""

    cause: ClassVar[str] = "position_backlash"
    equation: ClassVar[str] = "the sensor's lever stays within play/2 of the stem"
    source: ClassVar[str] = IEC_61298
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("play_m", "b", "m", "width of the play", 0.0, 0.005, 0.05, Per.TRAVEL),
    )

    play_m: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.sensor
        require_free(self.cause, slots, "play_m")
        filled = replace(slots, play_m=self.play_m)
        return replace(valve, sensor=filled)
