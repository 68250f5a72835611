"""A position reading that is bowed: a lever off its middle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import IEC_61298, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PositionNonlinearity(Effect):
    """A position reading that is bowed: a lever off its middle."""

    cause: ClassVar[str] = "position_nonlinearity"
    equation: ClassVar[str] = "y = x + 4 bow u (1 - u) (1 + s z + e z^2), u = (x - low)/span, z = 2 u - 1"
    source: ClassVar[str] = IEC_61298
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("bow_m", "n", "m", "excess in the middle of the span", -0.05, 0.01, 0.05, Per.TRAVEL),
        EffectParameter(
            "span_m", "L", "m", "span over which it is bowed", 0.5, 1.0, 1.5, Per.TRAVEL, is_strength=False
        ),
        EffectParameter("low_m", "x_l", "m", "lower end of the span", -0.2, 0.0, 0.2, Per.TRAVEL, is_strength=False),
        EffectParameter("skew", "s", "1", "how much more it is in the upper half", -1.0, 0.0, 1.0, is_strength=False),
        EffectParameter("ends", "e", "1", "how much more it is at the ends", -1.0, 0.0, 1.0, is_strength=False),
    )

    bow_m: float
    span_m: float
    low_m: float = 0.0
    skew: float = 0.0
    ends: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.sensor
        require_free(self.cause, slots, "bow_m")
        filled = replace(
            slots,
            bow_m=self.bow_m,
            bow_span_m=self.span_m,
            bow_low_m=self.low_m,
            bow_skew=self.skew,
            bow_ends=self.ends,
        )
        return replace(valve, sensor=filled)
