"""Friction that is larger one way than the other: packing, a bent stem, a side load."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class FrictionAsymmetry(Effect):
    """Friction that is larger one way than the other: packing, a bent stem, a side load."""

    cause: ClassVar[str] = "friction_asymmetry"
    equation: ClassVar[str] = "F_c, F_s -> F (1 + s a); F_v -> F_v (1 + s a_v); s = 1 opening, -1 closing"
    source: ClassVar[str] = (
        "A. Janot, M. Gautier, M. Brunot: Data set and reference models of EMPS, "
        "Workshop on Nonlinear System Identification Benchmarks (2019)"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "asymmetry",
            "a",
            "1",
            "half the difference of both ways over their mean, in F_c and F_s; above 0: opening is harder",
            -0.6,
            0.1,
            0.6,
        ),
        EffectParameter("viscous_asymmetry", "a_v", "1", "the same in F_v", -0.6, 0.0, 0.6),
    )

    asymmetry: float
    viscous_asymmetry: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "coulomb_asymmetry", "static_asymmetry", "viscous_asymmetry")
        filled = replace(
            slots,
            coulomb_asymmetry=self.asymmetry,
            static_asymmetry=self.asymmetry,
            viscous_asymmetry=self.viscous_asymmetry,
        )
        return replace(valve, friction=filled)
