"""A leak of the actuator or its tubing: the pressure stays below what the I/P should give."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, Effect, EffectParameter, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class ActuatorLeak(Effect):
    """A leak of the actuator or its tubing: the pressure stays below what the I/P should give."""

    cause: ClassVar[str] = "actuator_leak"
    equation: ClassVar[str] = "F_a = (1 - leak) F_asked once the pressure has settled"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("leak", "l", "1", "share of the gauge pressure that is missing", 0.0, 0.03, 0.5),
    )

    leak: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.input
        require_free(self.cause, slots, "leak")
        filled = replace(slots, leak=self.leak)
        return replace(valve, input=filled)
