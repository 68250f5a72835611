"""Friction that rises where the plug nears its seat."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.local_friction import LocalFriction as SpotEffect
from valve.messages import say

SEAT: Final = 0.03  # of the travel: what is tight here is tight at the seat
_WIDTHS: Final = (0.012, 0.02, 0.033, 0.055)  # of the travel, standard widths


class SeatFriction(Cause):
    """F_c + dF exp(-(x/width)^2/2) both ways, F_s by as much, x from the closed position."""

    name: ClassVar[str] = "seat_friction"
    action: ClassVar[str] = say(
        "seat_friction_action", "Look at seat, plug and its guide: galling, a deposit, a plug that is out of line."
    )

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 2.5 times F_c, over up to a tenth of the travel."""
        friction_n, travel_m = self.setting.friction_n, self.setting.travel_m
        return (
            parameter("rise_n", "N", 0.0, 2.5 * friction_n, spread=0.3 * friction_n),
            parameter("width_m", "m", 0.008 * travel_m, 0.1 * travel_m),
        )

    def shapes(self) -> list[Shape]:
        """Widths; none where the test does not come near the closed position."""
        setting = self.setting
        return [(width * setting.travel_m,) for width in _WIDTHS] if setting.low_m < SEAT * setting.travel_m else []

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the rise at these places."""
        return np.asarray(values[0] * np.exp(-0.5 * (np.maximum(where.travel_m, 0.0) / values[1]) ** 2))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes: a tight spot at the closed position."""
        return SpotEffect(float(values[0]), 0.0, float(values[1]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "friction_at_seat",
            "Friction is {rise} higher near closed, over the last {width:.1f} % of travel: at the seat.",
            rise=fitted["rise_n"].in_words("N"),
            width=self.setting.percent(2.0 * fitted["width_m"].value),
        )
