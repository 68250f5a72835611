"""A periodic force on the stem: the line or the plug shakes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PeriodicForce(Effect):
    """A periodic force on the stem: the line or the plug shakes."""

    cause: ClassVar[str] = "vibration"
    equation: ClassVar[str] = "F_a -> F_a + A sin(2 pi f t + phase), t from the start of the record"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("force_n", "A", "N", "amplitude", 0.0, 0.005, 0.1, Per.FULL_FORCE),
        EffectParameter("frequency_hz", "f", "Hz", "frequency", 0.3, 12.0, 60.0, is_strength=False),
        EffectParameter(
            "phase_rad",
            "phi",
            "rad",
            "phase at the start",
            -3.141592653589793,
            0.0,
            3.141592653589793,
            is_strength=False,
        ),
    )

    force_n: float
    frequency_hz: float
    phase_rad: float = 0.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.vibration
        require_free(self.cause, slots, "force_n")
        filled = replace(slots, force_n=self.force_n, frequency_hz=self.frequency_hz, phase_rad=self.phase_rad)
        return replace(valve, vibration=filled)
