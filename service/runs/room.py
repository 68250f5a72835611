"""What a further test of a valve may use, as the analysis is told it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from drivers.addresses import MotionLimits
from service.model.sequences import room_of
from valve.nameplate import Nameplate

_RANGE: Final = ("low_pa", "high_pa")


def room_to_json(nameplate: Nameplate, limits: MotionLimits, overrides: Mapping[str, Any]) -> dict[str, float]:
    """Return the room of this valve's limits, between the pressures that its last test went between."""
    room = room_of(nameplate, limits)
    own = {name: float(overrides[name]) for name in _RANGE if isinstance(overrides.get(name), int | float)}
    return {**asdict(room), **own}
