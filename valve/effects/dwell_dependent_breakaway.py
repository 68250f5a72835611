"""Static friction that grows with the time at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import ARMSTRONG, Effect, EffectParameter, Per, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class DwellDependentBreakaway(Effect):
    """Static friction that grows with the time at rest."""

    cause: ClassVar[str] = "dwell_dependent_breakaway"
    equation: ClassVar[str] = "F_s -> F_s + rise T/(T + tau) after a rest of T"
    source: ClassVar[str] = ARMSTRONG + ", the seven-parameter model"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("rise_n", "dF_s", "N", "rise after a long rest", 0.0, 0.3, 3.0, Per.FRICTION),
        EffectParameter(
            "time_s", "tau", "s", "rest after which half of it is there", 0.1, 2.0, 100.0, is_strength=False
        ),
    )

    rise_n: float
    time_s: float = 2.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "dwell_rise_n")
        filled = replace(slots, dwell_rise_n=self.rise_n, dwell_time_s=self.time_s)
        return replace(valve, friction=filled)
