"""A spring whose rate changes smoothly along the travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.spring_hardening import SpringHardening as HardeningEffect
from valve.messages import say


class SpringHardening(Cause):
    """k x + h x^2/2."""

    name: ClassVar[str] = "spring_hardening"
    action: ClassVar[str] = say(
        "spring_hardening_action", "Look at the actuator's spring: coils that close, a wrong spring."
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """A rate that changes by up to 60 % over the travel."""
        unit = self.setting.spring_n_per_m / self.setting.travel_m
        return (parameter("hardening_n_per_m2", "N/m^2", -0.4 * unit, 0.8 * unit, spread=0.1 * unit),)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return -h x^2/2."""
        return np.asarray(-0.5 * values[0] * where.travel_m**2)

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return HardeningEffect(float(values[0]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["hardening_n_per_m2"]
        share = entry.in_words("%", self.setting.travel_m / self.setting.spring_n_per_m)
        if entry.value > 0.0:
            return say("spring_rate_rises", "The spring's rate rises by {share} over the travel.", share=share)
        return say("spring_rate_falls", "The spring's rate falls by {share} over the travel.", share=share)
