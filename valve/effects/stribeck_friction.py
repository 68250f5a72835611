"""Friction that falls with speed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import ARMSTRONG, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class StribeckFriction(Effect):
    """Friction that falls with speed, from F_s to F_c: boundary lubrication.

    Where F_s is F_c there is nothing to fall: ``excess_n`` raises F_s.
    """

    cause: ClassVar[str] = "stribeck_friction"
    equation: ClassVar[str] = "F_c -> F_c + (F_s - F_c) exp(-(v/v_s)^2), F_s raised by an excess"
    source: ClassVar[str] = ARMSTRONG
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("speed_m_per_s", "v_s", "m/s", "speed at which the excess is down to 1/e", 0.0, 0.01, 0.2),
        EffectParameter("excess_n", "dF_s", "N", "rise of F_s", 0.0, 0.1, 2.0, Per.FRICTION),
    )

    speed_m_per_s: float
    excess_n: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots, static_n = valve.friction, valve.parameters.static_friction_n
        require_free(self.cause, slots, "stribeck_velocity_m_per_s")
        parameters = replace(valve.parameters, static_friction_n=static_n + self.excess_n)
        filled = replace(slots, stribeck_velocity_m_per_s=self.speed_m_per_s)
        return replace(valve, parameters=parameters, friction=filled)
