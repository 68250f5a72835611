"""A fitted parameter of a drive's cause: value and 95 % interval, as a number and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from valve.messages import UNITS, Message, say

_HUGE: Final = 1.0e6  # in the unit that is told
_MOST_FURTHER_DIGITS: Final = 4  # a narrower interval, below a millionth of its value, is of no use to anybody


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted parameter: value, SI, with the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str

    @property
    def half_width(self) -> float:
        """Half the interval."""
        return 0.5 * (self.high - self.low)

    def to_json(self) -> dict[str, Any]:
        """Return the parameter as in the analysis object."""
        return {"value": self.value, "ci95": [self.low, self.high], "unit": self.unit}


def with_interval(entry: Fitted, unit: str, scale: float = 1.0) -> Message:
    """Return ``scale`` times a value in this unit with its interval; without sign.

    The interval's ends have as many digits as tell them apart. Where the most digits do not, the value stands alone.
    """
    scale = -scale if entry.value < 0.0 else scale
    value, (low, high) = scale * entry.value, sorted((scale * entry.low, scale * entry.high))
    shown, least, most = (one / UNITS[unit][1] for one in (value, low, high))
    # a fitter needs three digits; an interval that is wider needs fewer
    width = max(0.5 * (most - least), 1.0e-2 * abs(shown), 1.0e-12)
    digits = min(max(0, 1 - math.floor(math.log10(width))), 6)
    is_huge = max(abs(shown), abs(least), abs(most)) >= _HUGE
    for more in range(_MOST_FURTHER_DIGITS + 1):
        number = f".{3 + more}g" if is_huge else f".{digits + more}f"
        if format(least, number) != format(most, number):
            return say(
                "fitted_from_to",
                "{value:{number} {unit}} ({low:{number} in {unit}} to {high:{number} in {unit}})",
                value=value,
                number=number,
                unit=unit,
                low=low,
                high=high,
            )
    number = ".3g" if is_huge else f".{digits}f"
    return say("fitted_value", "{value:{number} {unit}}", value=value, number=number, unit=unit)
