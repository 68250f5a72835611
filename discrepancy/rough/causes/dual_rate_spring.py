"""A spring whose rate changes at a knee."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.dual_rate_spring import DualRateSpring as KneeEffect
from valve.messages import say

_KNEES: Final = 33


class DualRateSpring(Cause):
    """k x + dk max(x - knee, 0)."""

    name: ClassVar[str] = "dual_rate_spring"
    action: ClassVar[str] = say(
        "dual_rate_spring_action",
        "Look at the actuator's springs: a second spring that meets, a broken one, coils that close.",
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """A rate that falls to a fifth or doubles somewhere in the travel swept; a plain fit's k is a mean of both."""
        setting = self.setting
        spring = setting.spring_n_per_m
        return (
            parameter("rate_change_n_per_m", "N/m", -1.4 * spring, 1.2 * spring, spread=0.1 * spring),
            parameter("knee_m", "m", setting.low_m, setting.high_m),
        )

    def shapes(self) -> list[Shape]:
        """Knees along the travel swept, but for its ends."""
        setting = self.setting
        return [(float(setting.low_m + setting.swept_m * share),) for share in np.linspace(0.1, 0.9, _KNEES)]

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return -dk max(x - knee, 0)."""
        return np.asarray(-values[0] * np.maximum(where.travel_m - values[1], 0.0))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return KneeEffect(float(values[0]), float(values[1]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry, knee_m, setting = fitted["rate_change_n_per_m"], fitted["knee_m"].value, self.setting
        # least squares give the first rate and this share of the change
        below = (knee_m - setting.low_m) / setting.swept_m
        first = setting.spring_n_per_m - entry.value * (1.0 - below) ** 2 * (1.0 + 2.0 * below)
        share = entry.in_words("%", 1.0 / max(first, setting.spring_n_per_m / 5.0))
        knee = setting.percent(knee_m)
        if entry.value > 0.0:
            return say(
                "spring_stiffer_beyond",
                "The spring is {share} stiffer beyond {knee:.1f} % travel.",
                share=share,
                knee=knee,
            )
        return say(
            "spring_softer_beyond", "The spring is {share} softer beyond {knee:.1f} % travel.", share=share, knee=knee
        )
