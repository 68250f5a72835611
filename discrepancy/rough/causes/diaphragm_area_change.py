"""An effective diaphragm area that changes along the travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.diaphragm_area_change import DiaphragmAreaChange as AreaEffect
from valve.messages import say


class DiaphragmAreaChange(Cause):
    """S_a (1 + b (x - middle of the travel swept))."""

    name: ClassVar[str] = "diaphragm_area_change"
    action: ClassVar[str] = say(
        "diaphragm_area_change_action", "Look at the diaphragm: stretched, wrongly seated, or of another type."
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 30 % over the travel."""
        most = 0.3 / self.setting.travel_m
        return (parameter("slope_per_m", "1/m", -most, most, spread=0.1 / self.setting.travel_m),)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the force beyond the nameplate's area's."""
        return np.asarray(where.force_n * values[0] * (where.travel_m - self.setting.middle_m))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return AreaEffect(float(values[0]), self.setting.middle_m)

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["slope_per_m"]
        share = entry.in_words("%", self.setting.travel_m)
        if entry.value > 0.0:
            return say("area_grows", "The diaphragm's effective area grows by {share} over the travel.", share=share)
        return say("area_shrinks", "The diaphragm's effective area shrinks by {share} over the travel.", share=share)
