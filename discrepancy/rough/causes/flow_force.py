"""The plug's unbalance in service."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.flow_force import FlowForce as FlowEffect
from valve.messages import say

_DECAYS: Final = (0.06, 0.1, 0.16, 0.25, 0.4)  # of the travel


class FlowForce(Cause):
    """F_f exp(-x/decay) beside the actuator's force; above 0 it opens."""

    name: ClassVar[str] = "flow_force"
    action: ClassVar[str] = say(
        "flow_force_action", "Compare with the process pressures of the test, or repeat it without flow."
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 30 % of the full force."""
        setting = self.setting
        most = 0.3 * setting.full_force_n
        return (
            parameter("force_n", "N", -most, most, spread=0.05 * setting.full_force_n),
            parameter("decay_m", "m", 0.03 * setting.travel_m, setting.travel_m),
        )

    def shapes(self) -> list[Shape]:
        """Decays over 6 to 40 % of the travel."""
        return [(share * self.setting.travel_m,) for share in _DECAYS]

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return F_f exp(-x/decay)."""
        return np.asarray(values[0] * np.exp(-np.maximum(where.travel_m, 0.0) / values[1]))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return FlowEffect(float(values[0]), float(values[1]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["force_n"]
        force, decay = entry.in_words("N"), self.setting.percent(fitted["decay_m"].value)
        if entry.value > 0.0:
            return say(
                "flow_opens",
                "A force on the plug of {force} at the seat opens the valve; it falls to a third over {decay:.0f} % "
                "travel.",
                force=force,
                decay=decay,
            )
        return say(
            "flow_closes",
            "A force on the plug of {force} at the seat closes the valve; it falls to a third over {decay:.0f} % "
            "travel.",
            force=force,
            decay=decay,
        )
