"""Static friction that grows with the time at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.dwell_dependent_breakaway import DwellDependentBreakaway as DwellEffect
from valve.messages import say

_TIMES_S: Final = (0.5, 1.5, 5.0, 15.0, 50.0)


class DwellDependentBreakaway(Cause):
    """F_s + rise T/(T + tau) after a rest of T."""

    name: ClassVar[str] = "dwell_dependent_breakaway"
    action: ClassVar[str] = say(
        "dwell_dependent_breakaway_action",
        "Move the valve a little now and then, or change the packing for one that sticks less.",
    )

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to three times F_c."""
        friction_n = self.setting.friction_n
        return (
            parameter("rise_n", "N", 0.0, 3.0 * friction_n, spread=0.3 * friction_n),
            parameter("time_s", "s", 0.1, 100.0),
        )

    def shapes(self) -> list[Shape]:
        """Times of half a second to a minute."""
        return [(time_s,) for time_s in _TIMES_S]

    @override
    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return the rise after this rest."""
        return np.asarray(values[0] * where.rested_s / (where.rested_s + values[1]))

    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes: what F_s was raised by is not in the rise."""
        return DwellEffect(float(max(values[0] - short_n, 0.0)), float(values[1]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "breakaway_grows_at_rest",
            "Breakaway grows with the time at rest, by up to {rise}, half after {time:.2g} s.",
            rise=fitted["rise_n"].in_words("N"),
            time=fitted["time_s"].value,
        )
