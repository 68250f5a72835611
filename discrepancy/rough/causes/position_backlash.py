"""Lost motion between the stem and the position sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.position_backlash import PositionBacklash as PlayEffect


class PositionBacklash(Cause):
    """A sensor that trails the stem by half of its play.

    In motion k play/2 looks like friction. At a breakaway it does so too if the stem goes on as it came, and has the
    other sign if it turns: so a test in which the stem rests and goes on shows it.
    """

    name: ClassVar[str] = "position_backlash"
    action: ClassVar[str] = "Look at the linkage between stem and position sensor: a worn pin, a loose clamp."
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 5 % of the travel."""
        return (parameter("play_m", "m", 0.0, 0.05 * self.setting.travel_m, spread=0.008 * self.setting.travel_m),)

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the spring's force over half of the play."""
        return np.full(where.count, 0.5 * values[0] * self.setting.spring_n_per_m)

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:  # noqa: ARG002
        """Return the same where the stem goes on, the opposite where it turns."""
        return np.asarray(where.direction * where.before * self.friction_n(values, where))

    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:  # noqa: ARG002
        """Return the effect that a simulated valve takes."""
        return PlayEffect(float(max(values[0], 0.0)))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return f"The position reading has {fitted['play_m'].in_words(1.0e3, 'mm')} of lost motion."
