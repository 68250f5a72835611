"""Friction that changes during the record: the packing warms, a lubricant spreads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import ARMSTRONG, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class FrictionDrift(Effect):
    """Friction that changes during the record: the packing warms, a lubricant spreads."""

    cause: ClassVar[str] = "friction_drift"
    equation: ClassVar[str] = "F_c, F_s -> F + change (1 - exp(-t/T)), t from the start of the record"
    source: ClassVar[str] = ARMSTRONG
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("change_n", "dF", "N", "change after a long time", -0.6, -0.1, 0.6, Per.FRICTION),
        EffectParameter("time_constant_s", "T", "s", "its time constant", 3.0, 40.0, 1000.0, is_strength=False),
    )

    change_n: float
    time_constant_s: float = 60.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "drift_n")
        filled = replace(slots, drift_n=self.change_n, drift_time_s=self.time_constant_s)
        return replace(valve, friction=filled)
