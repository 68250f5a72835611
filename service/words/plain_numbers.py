"""Numbers as people read them: rounded to what is known of them, with half of their 95 % interval."""

from __future__ import annotations

import math
import re
from typing import Any, Final

from valve.carried_digits import INSTRUMENT, carried_places
from valve.messages import Message, Value, as_told, fields, formed, say

# How a parameter itself varies in a test, by symbol.
_VARIES: Final = {
    "F_s": say("varies_by_breakaway", "from breakaway to breakaway"),
    "F_c": say("varies_along_travel", "along the travel and in time"),
}
_IN_TEST: Final = say("varies_in_this_test", "in this test")
_MOST_DIGITS: Final = 12  # after the point
_HUGE: Final = 1.0e7
_DIGITS: Final = (3, 4)  # fewest and most that are shown where a unit is changed
_SMALL: Final = 1.0e-3  # below it a number has five places: inches of a sensor's noise
_POWER: Final = re.compile(r"(?<![\w.])-?\d(?:\.\d+)?e\+0[1-5](?![\w.])")


def plus_minus(value: float, half_width: float | None, *, digits: int | None = None) -> str:
    """A measured value with half of its 95 % interval, with as many digits as that and the instrument carry.

    ``50.7 ± 1.2``, and ``50.7`` where the interval is narrower than what an instrument knows. A value that was set, and
    not measured, has ``digits`` digits.
    """
    if digits is not None and half_width is None:
        return _plain(value, digits)
    places, is_shown = carried_places(value, half_width)
    if not is_shown or half_width is None:
        return _at(value, places)
    return f"{_at(value, places)} ± {_at(half_width, places)}"


def half_width(interval: dict[str, Any] | None, scale: float = 1.0) -> float | None:
    """Half of the 95 % interval of an entry with ``ci95``, or None where there is none."""
    if interval is None or interval.get("ci95") is None:
        return None
    low, high = interval["ci95"]
    return 0.5 * scale * float(high - low)


def with_span(value: float, low: float, high: float) -> tuple[str, str]:
    """A measured value and the ends of its interval, ``250.0`` and ``248.8 to 251.2``, with the digits that they carry.

    An interval that is narrower than what an instrument knows is not told by its ends.
    """
    places, is_shown = carried_places(value, 0.5 * (high - low))
    span = f"{_at(low, places)} to {_at(high, places)}" if is_shown else f"within {100.0 * INSTRUMENT:g} %"
    return _at(value, places), span


def _at(value: float, places: int) -> str:
    """The value rounded to this place; with an exponent where it is huge or tiny."""
    if abs(value) >= _HUGE or places > _MOST_DIGITS:
        return f"{value:.3g}"
    # + 0.0: no minus before a zero
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}"


def _plain(value: float, digits: int) -> str:
    """``digits`` significant digits, without an exponent where that is readable."""
    if value == 0.0 or not 1.0e-4 <= abs(value) < _HUGE:
        return f"{value:.{digits}g}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}"


def digits_of(number: str) -> int:
    """Return with how many significant digits a number is written."""
    return sum(one.isdigit() for one in number.partition("e")[0].lstrip("+-0."))


def rounded(value: float, digits: int, more: int = 0) -> str:
    """Return a number that changed its unit, with about the ``digits`` that it had, and ``more``."""
    if 0.0 < abs(value) < _SMALL:
        return f"{value:.{5 + max(0, more - 1)}f}"
    return plus_minus(value, None, digits=min(_DIGITS[1] + more, max(_DIGITS[0], digits + more)))


def scatter_words(symbol: str, value: float | None, scatter: float | None) -> str:
    """How much a parameter itself varies, ``from breakaway to breakaway ± 2.4 %``; empty where none is seen.

    Less than an instrument knows is none.
    """
    if not value or scatter is None or abs(scatter) < INSTRUMENT * abs(value):
        return ""
    percent = f"{100.0 * scatter / abs(value):.2g}"
    return say("varies_by", "{how} ± {percent} %", how=_VARIES.get(symbol, _IN_TEST), percent=percent)


def as_read(sentence: str) -> str:
    """Return a sentence with ``1.2e+02`` as 120 and ``+-`` as ``±``, in the units that it has."""
    if isinstance(sentence, Message):
        return _message_as_read(sentence)
    return _POWER.sub(lambda found: f"{float(found.group()):.0f}", sentence).replace("+-", "±")


def _message_as_read(message: Message) -> str:
    parts = fields(message.template, message.values)
    told = (
        text.replace("+-", "±") + ("" if name is None else _value_as_read(message.values[name], spec))
        for text, name, spec in parts
    )
    return formed("".join(told), message.form)


def _value_as_read(value: Value, spec: str) -> str:
    if isinstance(value, tuple):
        return (spec or "; ").join(_value_as_read(one, "") for one in value)
    return as_read(value if isinstance(value, str) else as_told(value, spec))
