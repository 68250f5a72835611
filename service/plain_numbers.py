"""Numbers as people read them: rounded to what is known of them, with half of their 95 % interval."""

from __future__ import annotations

import math
import re
from typing import Any, Final

# How a parameter itself varies in a test, by symbol.
_VARIES: Final = {"F_s": "from breakaway to breakaway", "F_c": "along the travel and in time"}
_MOST_DIGITS: Final = 12  # after the point
_POWER: Final = re.compile(r"(?<![\w.])-?\d(?:\.\d+)?e\+0[1-5](?![\w.])")


def plus_minus(value: float, half_width: float | None, *, digits: int = 4) -> str:
    """Value and half of its interval with two digits of it; without an interval ``digits`` digits of the value."""
    if half_width is None:
        return _plain(value, digits)
    if half_width <= 0.0 or half_width < 1.0e-9 * abs(value):
        return f"{_plain(value, 8)} ± 0"
    places = 1 - math.floor(math.log10(half_width))
    if abs(value) >= 1.0e7 or places > _MOST_DIGITS:
        return f"{value:.{digits}g} ± {half_width:.2g}"
    if places <= 0:
        return f"{round(value, places):.0f} ± {round(half_width, places):.0f}"
    # + 0.0: no minus before a zero
    return f"{round(value, places) + 0.0:.{places}f} ± {half_width:.{places}f}"


def half_width(interval: dict[str, Any] | None, scale: float = 1.0) -> float | None:
    """Half of the 95 % interval of an entry with ``ci95``, or None where there is none."""
    if interval is None or interval.get("ci95") is None:
        return None
    low, high = interval["ci95"]
    return 0.5 * scale * float(high - low)


def with_span(value: float, low: float, high: float, *, digits: int = 5) -> tuple[str, str]:
    """Value and the ends of its interval, ``250.020`` and ``249.970 to 250.070``: with two digits of its half.

    Where there is no interval, ``digits`` digits of the value stand for all three.
    """
    half_width = 0.5 * (high - low)
    if not half_width > 1.0e-9 * abs(value):
        return _plain(value, digits), f"{_plain(low, digits)} to {_plain(high, digits)}"
    places = 1 - math.floor(math.log10(half_width))
    if abs(value) >= 1.0e7 or places > _MOST_DIGITS:
        return f"{value:.{digits}g}", f"{low:.{digits}g} to {high:.{digits}g}"
    shown, least, most = (f"{round(number, places) + 0.0:.{max(places, 0)}f}" for number in (value, low, high))
    return shown, f"{least} to {most}"


def _plain(value: float, digits: int) -> str:
    """``digits`` significant digits, without an exponent where that is readable."""
    if value == 0.0 or not 1.0e-4 <= abs(value) < 1.0e7:
        return f"{value:.{digits}g}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}"


def scatter_words(symbol: str, value: float | None, scatter: float | None) -> str:
    """How much a parameter itself varies, ``from breakaway to breakaway ± 2.4 %``; empty where none is seen."""
    if value is None or not value or scatter is None:
        return ""
    return f"{_VARIES.get(symbol, 'in this test')} ± {100.0 * scatter / abs(value):.2g} %"


def as_read(sentence: str) -> str:
    """Return a sentence with ``1.2e+02`` as 120 and ``+-`` as ``±``."""
    return _POWER.sub(lambda found: f"{float(found.group()):.0f}", sentence).replace("+-", "±")
