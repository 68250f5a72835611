"""A delay between the command and the pressure: long tubing, a slow device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, Effect, EffectParameter, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class TransducerDeadTime(Effect):
    """A delay between the command and the pressure: long tubing, a slow device."""

    cause: ClassVar[str] = "transducer_dead_time"
    equation: ClassVar[str] = "F_a(t) = F_asked(t - delay)"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("delay_s", "T_d", "s", "delay", 0.0, 0.15, 3.0),
    )

    delay_s: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.input
        require_free(self.cause, slots, "dead_time_s")
        filled = replace(slots, dead_time_s=self.delay_s)
        return replace(valve, input=filled)
