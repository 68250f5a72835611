"""Friction that changes during the record: the packing warms, a lubricant spreads."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import ARMSTRONG, STATIC_SHARE, Effect, EffectParameter, Per, require_free, with_static_share
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class FrictionDrift(Effect):
    """Friction that changes during the record: the packing warms, a lubricant spreads."""

    cause: ClassVar[str] = "friction_drift"
    equation: ClassVar[str] = (
        "F_c -> F_c + change (1 - exp(-t/T))/(1 - exp(-S/T)), F_s -> F_s + q times that, "
        "t from the start of the record; S = 0: over 1"
    )
    source: ClassVar[str] = ARMSTRONG
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("change_n", "dF", "N", "change by the time S", -0.6, -0.1, 0.6, Per.FRICTION),
        EffectParameter("time_constant_s", "T", "s", "its time constant", 3.0, 40.0, 1.0e5, is_strength=False),
        EffectParameter(
            "span_s", "S", "s", "when the change is reached; 0: after a long time", 0.0, 0.0, 1.0e5, is_strength=False
        ),
        STATIC_SHARE,
    )

    change_n: float
    time_constant_s: float = 60.0
    span_s: float = 0.0
    static_share: float = 1.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "drift_n")
        reached = -math.expm1(-self.span_s / self.time_constant_s) if self.span_s > 0.0 else 1.0
        filled = replace(slots, drift_n=self.change_n / reached, drift_time_s=self.time_constant_s)
        return replace(valve, friction=with_static_share(self.cause, filled, self.static_share))
