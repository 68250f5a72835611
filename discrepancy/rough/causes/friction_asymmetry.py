"""Friction that is larger one way than the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.friction_asymmetry import FrictionAsymmetry as AsymmetryEffect
from valve.messages import say


class FrictionAsymmetry(Cause):
    """F_c, F_s -> F (1 + s a), as a force: half of the difference of both ways, N."""

    name: ClassVar[str] = "friction_asymmetry"
    action: ClassVar[str] = say(
        "friction_asymmetry_action", "Look at packing and stem guide for a side load or a lip that points one way."
    )
    is_offset: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Half of the difference: up to 60 % of F_c."""
        most = 0.6 * self.setting.friction_n
        return (parameter("half_difference_n", "N", -most, most, spread=0.15 * self.setting.friction_n),)

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return s D."""
        return np.asarray(where.direction * values[0])

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return the same share of F_s."""
        return share * self.friction_n(values, where)

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return AsymmetryEffect(float(np.clip(values[0] / self.setting.friction_n, -0.95, 0.95)))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["half_difference_n"]
        more = entry.in_words("N", 2.0)
        if entry.value > 0.0:
            return say("harder_opening", "Friction is {more} higher opening than closing.", more=more)
        return say("harder_closing", "Friction is {more} higher closing than opening.", more=more)
