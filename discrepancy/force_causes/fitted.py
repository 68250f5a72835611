"""A fitted parameter of a drive's cause: value and 95 % interval, as a number and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

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


def with_interval(entry: Fitted, factor: float, unit: str) -> str:
    """Return a value times ``factor`` with its interval and unit; without sign.

    The interval's ends have as many digits as tell them apart. Where the most digits do not, the value stands alone.
    """
    factor = -factor if entry.value < 0.0 else factor
    value = factor * entry.value
    low, high = sorted((factor * entry.low, factor * entry.high))
    # a fitter needs three digits; an interval that is wider needs fewer
    width = max(0.5 * (high - low), 1.0e-2 * abs(value), 1.0e-12)
    digits = min(max(0, 1 - math.floor(math.log10(width))), 6)
    for more in range(_MOST_FURTHER_DIGITS + 1):
        shown, least, most = (_number(one, digits + more, 3 + more) for one in (value, low, high))
        if least != most:
            return f"{shown} {unit} ({least} to {most})"
    return f"{_number(value, digits, 3)} {unit}"


def _number(value: float, places: int, digits: int) -> str:
    """Return a number with ``places`` after its point, or with ``digits`` in all where it is very large."""
    return f"{value:.{places}f}" if abs(value) < 1.0e6 else f"{value:.{digits}g}"
