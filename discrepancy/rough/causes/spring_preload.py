"""A preload that is not the nameplate's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.spring_preload import SpringPreload as PreloadEffect
from valve.messages import say


class SpringPreload(Cause):
    """F_0 beside the one of the nameplate's bench set; without a bench set nothing shows it."""

    name: ClassVar[str] = "spring_preload"
    action: ClassVar[str] = say(
        "spring_preload_action", "Set the spring's preload to the nameplate's bench set, or correct the nameplate."
    )
    needs_spring: ClassVar[bool] = True
    is_offset: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 30 % of the full force."""
        most = 0.3 * self.setting.full_force_n
        return (parameter("offset_n", "N", -most, most, spread=0.05 * self.setting.full_force_n),)

    def shapes(self) -> list[Shape]:
        """Nothing to try where the nameplate has no bench set."""
        return [] if self.setting.preload_n is None else [()]

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return -dF_0."""
        return np.full(where.count, -values[0])

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return PreloadEffect(float(values[0]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        entry = fitted["offset_n"]
        offset = entry.in_words("N")
        if entry.value > 0.0:
            return say(
                "preload_above", "The spring's preload is {offset} above the nameplate's bench set.", offset=offset
            )
        return say("preload_below", "The spring's preload is {offset} below the nameplate's bench set.", offset=offset)
