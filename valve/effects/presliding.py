"""A stem that moves elastically before it breaks away: Dahl's bristles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class Presliding(Effect):
    """A stem that moves elastically before it breaks away: Dahl's bristles."""

    cause: ClassVar[str] = "presliding"
    equation: ClassVar[str] = (
        "dF/dx = (F_s/deflection) (1 - |F|/F_m) towards the motion, F_m = F_s/0.98; it gives way at |F| = F_s"
    )
    source: ClassVar[str] = "P. R. Dahl: A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1 (1968)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "deflection_m", "delta", "m", "F_s over the stiffness of the bristles", 0.0, 0.001, 0.04, Per.TRAVEL
        ),
    )

    deflection_m: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "presliding_m")
        filled = replace(slots, presliding_m=self.deflection_m)
        return replace(valve, friction=filled)
