"""A tight spot, or a worn one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, Shape, parameter
from discrepancy.rough.causes.seat_friction import SEAT
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.local_friction import LocalFriction as SpotEffect
from valve.messages import say

_WIDTHS: Final = (0.008, 0.014, 0.025, 0.045, 0.08)  # of the travel, standard widths
_PLACES: Final = 60
_BEYOND: Final = 0.02  # of the travel: a spot may stop the stem before its middle
_HALF_RISE: Final = 1.1774  # standard widths from the centre to half of the rise


class LocalFriction(Cause):
    """F_c + dF exp(-((x - centre)/width)^2/2) both ways, F_s by as much."""

    name: ClassVar[str] = "local_friction"
    action: ClassVar[str] = say(
        "local_friction_action", "Look at stem and packing there: a bent stem, galling, a deposit."
    )

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 2.5 times F_c, anywhere in the travel swept, and a little beyond, but at the seat."""
        setting = self.setting
        return (
            parameter(
                "rise_n", "N", -0.5 * setting.friction_n, 2.5 * setting.friction_n, spread=0.2 * setting.friction_n
            ),
            parameter("centre_m", "m", self._lowest_m, self._highest_m),
            parameter("width_m", "m", 0.005 * setting.travel_m, 0.1 * setting.travel_m),
        )

    def shapes(self) -> list[Shape]:
        """Places along the travel swept, each with all widths."""
        setting = self.setting
        places_m = self._lowest_m + (self._highest_m - self._lowest_m) * (np.arange(_PLACES) + 0.5) / _PLACES
        return [(float(place_m), width * setting.travel_m) for width in _WIDTHS for place_m in places_m]

    @property
    def _lowest_m(self) -> float:
        # nearer to the closed position it is the seat's
        least_m = self.setting.low_m - _BEYOND * self.setting.travel_m
        return min(max(least_m, SEAT * self.setting.travel_m), self.setting.middle_m)

    @property
    def _highest_m(self) -> float:
        return self.setting.high_m + _BEYOND * self.setting.travel_m

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the rise at these places."""
        return np.asarray(values[0] * np.exp(-0.5 * ((where.travel_m - values[1]) / values[2]) ** 2))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return SpotEffect(float(values[0]), float(values[1]), float(values[2]))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        rise, centre_m, half_m = fitted["rise_n"], fitted["centre_m"].value, _HALF_RISE * fitted["width_m"].value
        low, high = self.setting.percent(centre_m - half_m), self.setting.percent(centre_m + half_m)
        if rise.value > 0.0:
            return say(
                "tight_spot",
                "Friction is {rise} higher between {low:.1f} and {high:.1f} % travel, both ways: a tight spot.",
                rise=rise.in_words("N"),
                low=low,
                high=high,
            )
        return say(
            "worn_spot",
            "Friction is {rise} lower between {low:.1f} and {high:.1f} % travel, both ways: a worn spot.",
            rise=rise.in_words("N"),
            low=low,
            high=high,
        )
