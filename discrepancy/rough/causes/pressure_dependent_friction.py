"""Friction that grows with the actuator's pressure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.pressure_dependent_friction import PressureDependentFriction as PressureEffect
from valve.messages import say


class PressureDependentFriction(Cause):
    """F_c + mu |U|, F_s by as much."""

    name: ClassVar[str] = "pressure_dependent_friction"
    action: ClassVar[str] = say("pressure_dependent_friction_action", "Look at the piston's or diaphragm's seals.")
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 15 % of the force, and to F_c at the full force."""
        most = min(0.15, 1.5 * self.setting.friction_n / self.setting.full_force_n)
        return (parameter("share", "1", 0.0, most, spread=0.3 * self.setting.friction_n / self.setting.full_force_n),)

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return mu |U|."""
        return np.asarray(values[0] * np.abs(where.force_n))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return PressureEffect(float(values[0]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "friction_grows_with_pressure",
            "Friction grows with the pressure, by {share} of the actuator's force.",
            share=fitted["share"].in_words("%"),
        )
