"""A spring rate that no valve of this nameplate has: the pressure's unit, or a scale, is wrong."""

from __future__ import annotations

import math
from typing import Final

from valve.nameplate import Nameplate

_WRONG_UNITS: Final = ((6894.757, "psi"), (1.0e5, "bar"), (1.0e3, "kPa"))
_NEAR_UNIT: Final = 2.0  # times; psi, kPa and bar are 6.9 apart
_SCALE_OFF: Final = 2.0  # of the spring rate: no effect of the catalogue goes so far


def wrong_scale(spring_n_per_m: float, nameplate: Nameplate) -> str:
    """Return what is wrong with a scale where the spring rate says so; empty where it does not."""
    nominal = nameplate.nominal_spring_rate_n_per_m
    if nominal is None:
        return ""
    ratio = spring_n_per_m / nominal
    for factor, unit in _WRONG_UNITS:
        for wrong, sense in ((1.0 / factor, f"is in {unit} and was read as Pa"), (factor, f"was taken for {unit}")):
            if ratio > 0.0 and abs(math.log(ratio / wrong)) < math.log(_NEAR_UNIT):
                return (
                    f"The spring is {ratio:.3g} times as stiff as the nameplate's bench set says: the pressure "
                    f"{sense}, it seems. Correct the pressure's unit."
                )
    if not 1.0 / _SCALE_OFF < ratio < _SCALE_OFF:
        return (
            f"The spring is {ratio:.3g} times as stiff as the nameplate's bench set says, so the misfit is a scale: "
            "correct the bench set, the travel, or the range of the pressure or the position."
        )
    return ""
