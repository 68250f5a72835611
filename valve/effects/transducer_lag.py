"""A first-order lag of the I/P and the actuator's filling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import Effect, EffectParameter, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class TransducerLag(Effect):
    """A first-order lag of the I/P and the actuator's filling."""

    cause: ClassVar[str] = "transducer_lag"
    equation: ClassVar[str] = "T F_a' = F_asked - F_a"
    source: ClassVar[str] = (
        "F. G. Marques, thesis, Universidade de Sao Paulo (tde-12022020-100441): an I/P time constant of 0.933 s"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("lag_s", "T", "s", "time constant", 0.0, 0.3, 5.0),
    )

    lag_s: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.input
        require_free(self.cause, slots, "lag_s")
        filled = replace(slots, lag_s=self.lag_s)
        return replace(valve, input=filled)
