"""Friction that changes during the record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.friction_drift import FrictionDrift as DriftEffect
from valve.messages import say

_TIMES: Final = (0.1, 0.2, 0.4, 0.8, 20.0)  # of the record; the last one is straight in time


class FrictionDrift(Cause):
    """F_c + change (1 - exp(-t/T))/(1 - exp(-S/T)) over the record of S, F_s by as much."""

    name: ClassVar[str] = "friction_drift"
    action: ClassVar[str] = say(
        "friction_drift_action", "Repeat the test when the packing is warm; look at its lubrication and load."
    )

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to F_c over the record."""
        friction_n, duration_s = self.setting.friction_n, self.setting.duration_s
        return (
            parameter("change_n", "N", -friction_n, friction_n, spread=0.12 * friction_n),
            parameter("time_constant_s", "s", 0.05 * duration_s, 30.0 * duration_s),
        )

    def shapes(self) -> list[Shape]:
        """Time constants of a tenth of the record up to a straight line."""
        return [(share * self.setting.duration_s,) for share in _TIMES]

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the change up to now."""
        whole = -np.expm1(-self.setting.duration_s / values[1])
        return np.asarray(values[0] * -np.expm1(-where.time_s / values[1]) / whole)

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return DriftEffect(float(values[0]), float(values[1]), self.setting.duration_s)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["change_n"]
        change = entry.in_words("N")
        if entry.value > 0.0:
            return say("friction_rises_in_time", "Friction rises by {change} during the record.", change=change)
        return say("friction_falls_in_time", "Friction falls by {change} during the record.", change=change)
