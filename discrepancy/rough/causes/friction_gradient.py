"""Friction that grows along the travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.friction_gradient import FrictionGradient as GradientEffect
from valve.messages import say


class FrictionGradient(Cause):
    """F_c + g (x - middle of the travel swept), F_s by as much."""

    name: ClassVar[str] = "friction_gradient"
    action: ClassVar[str] = say("friction_gradient_action", "Look at the guide: out of line, or worn at one end.")

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to what leaves no friction at one end of the travel swept."""
        most = 2.0 * self.setting.friction_n / self.setting.swept_m
        unit = self.setting.friction_n / self.setting.travel_m
        return (parameter("gradient_n_per_m", "N/m", -most, most, spread=0.3 * unit),)

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return g (x - middle)."""
        return np.asarray(values[0] * (where.travel_m - self.setting.middle_m))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return GradientEffect(float(values[0]), self.setting.middle_m)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["gradient_n_per_m"]
        change = entry.in_words("N", self.setting.travel_m)
        if entry.value > 0.0:
            return say("friction_rises_along_travel", "Friction rises by {change} over the travel.", change=change)
        return say("friction_falls_along_travel", "Friction falls by {change} over the travel.", change=change)
