"""Friction that grows along the travel: a guide out of line, wear at one end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, STATIC_SHARE, Effect, EffectParameter, Per, require_free, with_static_share
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class FrictionGradient(Effect):
    """Friction that grows along the travel: a guide out of line, wear at one end."""

    cause: ClassVar[str] = "friction_gradient"
    equation: ClassVar[str] = "F_c -> F_c + g (x - reference) + b (x - reference)^2, F_s -> F_s + q times that"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "gradient_n_per_m", "g", "N/m", "rise of the friction per way", -1.0, 0.1, 1.0, Per.FRICTION_OVER_TRAVEL
        ),
        EffectParameter(
            "reference_m", "x_r", "m", "where F_c and F_s hold", 0.0, 0.5, 1.0, Per.TRAVEL, is_strength=False
        ),
        EffectParameter(
            "bend_n_per_m2",
            "b",
            "N/m2",
            "how much more it grows farther away",
            -4.0,
            0.0,
            4.0,
            Per.FRICTION_OVER_TRAVEL_SQUARED,
            is_strength=False,
        ),
        STATIC_SHARE,
    )

    gradient_n_per_m: float
    reference_m: float = 0.0
    bend_n_per_m2: float = 0.0
    static_share: float = 1.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "gradient_n_per_m")
        filled = replace(
            slots,
            gradient_n_per_m=self.gradient_n_per_m,
            gradient_reference_m=self.reference_m,
            gradient_bend_n_per_m2=self.bend_n_per_m2,
        )
        return replace(valve, friction=with_static_share(self.cause, filled, self.static_share))
