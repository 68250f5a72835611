"""Friction that falls with speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.stribeck_friction import StribeckFriction as StribeckEffect
from valve.messages import say

_SPEEDS: Final = (0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 5.0)  # of the usual speed


class StribeckFriction(Cause):
    """F_c + dF exp(-(v/v_s)^2) in motion; the breakaway has an F_s of its own."""

    name: ClassVar[str] = "stribeck_friction"
    action: ClassVar[str] = say(
        "stribeck_friction_action", "The stem will stick and slip at low speed: lubricate or change the packing."
    )

    by_slips: ClassVar[bool] = False  # all slips are equally quick

    def natural(self) -> tuple[LawParameter, ...]:
        """An excess of up to twice F_c."""
        setting = self.setting
        return (
            parameter("excess_n", "N", 0.0, 2.0 * setting.friction_n, spread=0.15 * setting.friction_n),
            parameter("speed_m_per_s", "m/s", 0.05 * setting.speed_m_per_s, 20.0 * setting.speed_m_per_s),
        )

    def shapes(self) -> list[Shape]:
        """Speeds about the usual one; none of a stem that creeps, whose friction falls with speed anyway."""
        if self.setting.creeps:
            return []
        return [(share * self.setting.speed_m_per_s,) for share in _SPEEDS]

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what is left of the excess at this speed."""
        return np.asarray(values[0] * np.exp(-((where.speed_m_per_s / values[1]) ** 2)))

    @override
    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return nothing: F_s is free."""
        return np.zeros(where.count)

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes: F_s is already the whole of it."""
        return StribeckEffect(float(values[1]), 0.0)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "friction_falls_with_speed",
            "Friction falls with speed, by {excess}, most of it over {speed:.3g mm/s}.",
            excess=fitted["excess_n"].in_words("N"),
            speed=fitted["speed_m_per_s"].value,
        )
