"""Sentences as people read them: the quantities in them in the units that a person chose."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from service.words.plain_numbers import as_read, plus_minus
from service.words.units import UnitSystem, shown_unit

#: How a verdict without a fault is said; what follows it says how friction varies.
NO_FAULT: Final = "No fault found."
# What sentences name, the SI unit that it is shown by, and how many of that it is.
_NAMED: Final = {
    "N*s/m": ("N*s/m", 1.0),
    "N/s": ("N/s", 1.0),
    "kPa/s": ("Pa/s", 1.0e3),
    "Pa/s": ("Pa/s", 1.0),
    "kPa": ("Pa", 1.0e3),
    "Pa": ("Pa", 1.0),
    "mm/s": ("m/s", 1.0e-3),
    "m/s": ("m/s", 1.0),
    "mm": ("m", 1.0e-3),
    "um": ("m", 1.0e-6),
    "m": ("m", 1.0),
    "N/mm": ("N/m", 1.0e3),
    "N/m": ("N/m", 1.0),
    "N": ("N", 1.0),
}
# A mass m in a formula, as in sqrt(2 m DV r), is no metre.
_NUMBER: Final = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_QUANTITY: Final = re.compile(
    rf"(?<![\w.])(?<!sqrt\()(?P<numbers>(?:between\s{_NUMBER}\sand\s)?{_NUMBER}(?:\s(?:to|±)\s{_NUMBER})*)\s"
    rf"(?P<unit>{'|'.join(map(re.escape, sorted(_NAMED, key=len, reverse=True)))})(?![\w/*·]|\s(?:DV|F_))"
    rf"(?P<interval>\s\((?:{_NUMBER}\sto\s{_NUMBER}|\+{_NUMBER})\))?"
)
_EACH: Final = re.compile(rf"(?<![\w.]){_NUMBER}")
_DIGITS: Final = (3, 4)  # fewest and most that are shown where a unit is changed
_MOST_FURTHER_DIGITS: Final = 6  # for an interval that is narrow beside its value
_SMALL: Final = 1.0e-3  # below it a number has five places: inches of a sensor's noise
_LARGE_UM: Final = 100.0  # from here on metric lengths are read in mm
_IN_UM: Final = {"um": 1.0, "m": 1.0e6}  # what is written in mm was large to whoever wrote it


def in_units(text: str, system: UnitSystem) -> str:
    """Return a sentence with its lengths, pressures and forces in the units of ``system``.

    ``it stood at 0.0485455 m`` becomes ``it stood at 48.55 mm``, or ``1.911 in``. A number whose unit stays is left
    as it is; a small length is read in µm where lengths are metric. An interval in brackets goes with
    its value. ``+-`` becomes ``±``, and ``1.2e+02`` 120.
    """
    return as_read(_QUANTITY.sub(lambda found: _in_unit(found, system), text))


def as_sentence(text: str) -> str:
    """Return ``text`` with a capital at its begin and a stop at its end; "" stays."""
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if not text or text.endswith((".", "!", "?")) else ".")


def all_in_units(content: Any, system: UnitSystem) -> Any:
    """Return ``content`` (texts in lists and mappings) with every text in the units of ``system``."""
    if isinstance(content, str):
        return in_units(content, system)
    if isinstance(content, Mapping):
        return {key: all_in_units(value, system) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [all_in_units(value, system) for value in content]
    return content


def _in_unit(found: re.Match[str], system: UnitSystem) -> str:
    numbers, named, interval = found["numbers"], found["unit"], found["interval"] or ""
    si_unit, in_si = _NAMED[named]
    unit = shown_unit(si_unit, system)
    if unit.name == named:
        return found.group()
    in_um = _IN_UM.get(named) if unit.name == "mm" else None
    if in_um is not None:
        largest_um = in_um * max(abs(float(one)) for one in _EACH.findall(numbers))
        if largest_um < _LARGE_UM and (largest_um > 0.0 or named == "um"):
            if in_um == 1.0:
                return f"{numbers} µm{interval}"
            shown, between = _apart(numbers, interval, partial(_small_length, in_um))
            return f"{shown} µm{between}"
    shown, between = _apart(numbers, interval, partial(_converted, in_si / unit.in_si))
    return f"{shown} {unit.name}{between}"


def _apart(numbers: str, interval: str, converted: Callable[[int, str], str]) -> tuple[str, str]:
    """Return both with every number ``converted``, with so many more digits that an interval's ends differ as before.

    An interval takes one more digit in any case.
    """
    differ = len(set(_EACH.findall(interval))) > 1
    more = 1 if interval else 0
    while True:
        convert = partial(converted, more)
        shown, between = _each(convert, numbers), _each(convert, interval)
        if not differ or more == _MOST_FURTHER_DIGITS or len(set(_EACH.findall(between))) > 1:
            return shown, between
        more += 1


def _each(convert: Callable[[str], str], text: str) -> str:
    return _EACH.sub(lambda one: convert(one.group()), text)


def _small_length(factor: float, more: int, number: str) -> str:
    return f"{factor * float(number):.{3 + more}g}"


def _converted(factor: float, more: int, number: str) -> str:
    digits = more + len(re.sub(r"e.*|\D", "", number).lstrip("0"))
    value = float(number) * factor
    if 0.0 < abs(value) < _SMALL:
        return f"{value:.{5 + max(0, more - 1)}f}"
    return plus_minus(value, None, digits=min(_DIGITS[1] + more, max(_DIGITS[0], digits)))
