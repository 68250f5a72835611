"""A position reading that lags: a filter in the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import IEC_61298, Effect, EffectParameter, require_free
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class PositionLag(Effect):
    """A position reading that lags: a filter in the sensor."""

    cause: ClassVar[str] = "position_lag"
    equation: ClassVar[str] = "T y' = x - y"
    source: ClassVar[str] = IEC_61298
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("lag_s", "T", "s", "time constant", 0.0, 0.03, 1.0),
    )

    lag_s: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.sensor
        require_free(self.cause, slots, "lag_s")
        filled = replace(slots, lag_s=self.lag_s)
        return replace(valve, sensor=filled)
