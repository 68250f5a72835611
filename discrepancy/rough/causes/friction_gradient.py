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


class FrictionGradient(Cause):
    """F_c + g (x - middle of the travel swept), F_s by as much."""

    name: ClassVar[str] = "friction_gradient"
    action: ClassVar[str] = "Look at the guide: out of line, or worn at one end."

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to once F_c over the travel."""
        unit = self.setting.friction_n / self.setting.travel_m
        return (parameter("gradient_n_per_m", "N/m", -1.5 * unit, 1.5 * unit, spread=0.3 * unit),)

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
        sense = "rises" if entry.value > 0.0 else "falls"
        return f"Friction {sense} by {entry.in_words(self.setting.travel_m, 'N')} over the travel."
