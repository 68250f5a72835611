"""The plug's unbalance in service, largest at the seat and decaying along the travel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class FlowForce(Effect):
    """The plug's unbalance in service, largest at the seat and decaying along the travel."""

    cause: ClassVar[str] = "flow_force"
    equation: ClassVar[str] = "F_a -> F_a + F_f exp(-x/decay); above 0 it opens"
    source: ClassVar[str] = "H. E. Merritt: Hydraulic Control Systems (1967)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("force_n", "F_f", "N", "force on the plug at the seat", -0.3, 0.03, 0.3, Per.FULL_FORCE),
        EffectParameter(
            "decay_m", "x_f", "m", "travel over which it falls to 1/e", 0.03, 0.2, 1.0, Per.TRAVEL, is_strength=False
        ),
    )

    force_n: float
    decay_m: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.spring
        require_free(self.cause, slots, "flow_force_n")
        filled = replace(slots, flow_force_n=self.force_n, flow_decay_m=self.decay_m)
        return replace(valve, spring=filled)
