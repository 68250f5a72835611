"""A position reading that is bowed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.position_nonlinearity import PositionNonlinearity as BowEffect
from valve.messages import say


class PositionNonlinearity(Cause):
    """y = x + bow 4 u (1 - u), u = x/travel: in the balance of forces k times the bow is missing."""

    name: ClassVar[str] = "position_nonlinearity"
    action: ClassVar[str] = say(
        "position_nonlinearity_action",
        "Put the sensor's lever square to the stem at mid travel, or linearise the sensor.",
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 10 % of the travel."""
        most = 0.1 * self.setting.travel_m
        return (parameter("bow_m", "m", -most, most, spread=0.025 * self.setting.travel_m),)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the spring's force that the reading has too much, at the place where the stem is."""
        v, bow = where.travel_m / self.setting.travel_m, 4.0 * values[0] / self.setting.travel_m
        # v = u + bow u (1 - u), solved for u
        u = 2.0 * v / (1.0 + bow + np.sqrt(np.maximum((1.0 + bow) ** 2 - 4.0 * bow * v, 0.0)))
        return np.asarray(self.setting.spring_n_per_m * values[0] * 4.0 * u * (1.0 - u))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return BowEffect(float(values[0]), self.setting.travel_m)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["bow_m"]
        share = entry.in_words("%", 1.0 / self.setting.travel_m)
        if entry.value > 0.0:
            return say(
                "reads_high_mid_travel",
                "The position reads up to {share} of the travel too high at mid travel.",
                share=share,
            )
        return say(
            "reads_low_mid_travel", "The position reads up to {share} of the travel too low at mid travel.", share=share
        )
