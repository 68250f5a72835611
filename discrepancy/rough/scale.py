"""A spring rate that no valve of this nameplate has: the pressure's unit, or a scale, is wrong."""

from __future__ import annotations

import math
from typing import Final

from valve.messages import Message, say
from valve.nameplate import Nameplate

_WRONG_UNITS: Final = ((6894.757, "psi"), (1.0e5, "bar"), (1.0e3, "kPa"))
_NEAR_UNIT: Final = 2.0  # times; psi, kPa and bar are 6.9 apart
_SCALE_OFF: Final = 2.0  # of the spring rate: no effect of the catalogue goes so far


def wrong_scale(spring_n_per_m: float, nameplate: Nameplate) -> Message | None:
    """Return what is wrong with a scale where the spring rate says so; None where it does not."""
    nominal = nameplate.nominal_spring_rate_n_per_m
    if nominal is None:
        return None
    ratio = spring_n_per_m / nominal
    for factor, unit in _WRONG_UNITS:
        if _is_near(ratio, 1.0 / factor):
            return say(
                "pressure_read_as_pa",
                "The spring is {ratio:.3g} times as stiff as the nameplate's bench set says: the pressure is in "
                "{unit} and was read as Pa, it seems. Correct the pressure's unit.",
                ratio=ratio,
                unit=unit,
            )
        if _is_near(ratio, factor):
            return say(
                "pressure_taken_for",
                "The spring is {ratio:.3g} times as stiff as the nameplate's bench set says: the pressure was taken "
                "for {unit}, it seems. Correct the pressure's unit.",
                ratio=ratio,
                unit=unit,
            )
    if not 1.0 / _SCALE_OFF < ratio < _SCALE_OFF:
        return say(
            "scale_is_wrong",
            "The spring is {ratio:.3g} times as stiff as the nameplate's bench set says, so the misfit is a scale: "
            "correct the bench set, the travel, or the range of the pressure or the position.",
            ratio=ratio,
        )
    return None


def _is_near(ratio: float, wrong: float) -> bool:
    return ratio > 0.0 and abs(math.log(ratio / wrong)) < math.log(_NEAR_UNIT)
