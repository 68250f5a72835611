"""Friction that grows with the actuator pressure: lip seals and piston rings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import STATIC_SHARE, Effect, EffectParameter, require_free, with_static_share
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PressureDependentFriction(Effect):
    """Friction that grows with the actuator pressure: lip seals and piston rings."""

    cause: ClassVar[str] = "pressure_dependent_friction"
    equation: ClassVar[str] = "F_c -> F_c + mu |F_a|, F_s -> F_s + q times that, F_a the actuator force S_a P"
    source: ClassVar[str] = (
        "G. Belforte, N. D'Alfio, T. Raparelli: Experimental analysis of friction forces in pneumatic cylinders, "
        "Journal of Fluid Control 20 (1989) 42-60"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("share", "mu", "1", "friction per actuator force", 0.0, 0.01, 0.15),
        STATIC_SHARE,
    )

    share: float
    static_share: float = 1.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "pressure_share")
        filled = replace(slots, pressure_share=self.share)
        return replace(valve, friction=with_static_share(self.cause, filled, self.static_share))
