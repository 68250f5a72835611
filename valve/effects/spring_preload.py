"""A bench set that differs from the nameplate's."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from valve.effects.base import HANDBOOK, Effect, EffectParameter, Per
from valve.extended_valve import ExtendedValve


@dataclass(frozen=True, slots=True)
class SpringPreload(Effect):
    """A bench set that differs from the nameplate's: the adjuster was turned."""

    cause: ClassVar[str] = "spring_preload"
    equation: ClassVar[str] = "F_0 -> F_0 + offset"
    source: ClassVar[str] = HANDBOOK
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("offset_n", "dF_0", "N", "preload beyond the nameplate's", -0.3, 0.03, 0.3, Per.FULL_FORCE),
    )

    offset_n: float

    def apply(self, valve: ExtendedValve) -> ExtendedValve:
        """Return the valve with this effect in it."""
        preload_n = valve.parameters.preload_n + self.offset_n
        return replace(valve, parameters=replace(valve.parameters, preload_n=preload_n))
