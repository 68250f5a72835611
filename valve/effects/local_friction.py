"""A tight spot: friction raised over a few percent of the travel (bent stem, galling)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, STATIC_SHARE, Effect, EffectParameter, Per, require_free, with_static_share
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class LocalFriction(Effect):
    """A tight spot: friction raised over a few percent of the travel (bent stem, galling)."""

    cause: ClassVar[str] = "local_friction"
    equation: ClassVar[str] = "F_c -> F_c + rise exp(-((x - centre)/width)^2/2), F_s -> F_s + q times that"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            "rise_n", "dF", "N", "friction at the spot beyond that elsewhere", -0.5, 0.15, 2.0, Per.FRICTION
        ),
        EffectParameter("centre_m", "x_c", "m", "where the spot is", 0.0, 0.5, 1.0, Per.TRAVEL, is_strength=False),
        EffectParameter(
            "width_m",
            "w",
            "m",
            "standard width: 2.35 of it wide at half the rise",
            0.003,
            0.02,
            0.2,
            Per.TRAVEL,
            is_strength=False,
        ),
        STATIC_SHARE,
    )

    rise_n: float
    centre_m: float
    width_m: float
    static_share: float = 1.0

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        slots = valve.friction
        require_free(self.cause, slots, "spot_n")
        filled = replace(slots, spot_n=self.rise_n, spot_centre_m=self.centre_m, spot_width_m=self.width_m)
        return replace(valve, friction=with_static_share(self.cause, filled, self.static_share))
