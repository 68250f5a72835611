"""Sentences as people read them: the quantities in them in the units that a person chose."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from service.plain_numbers import as_read, plus_minus
from service.shown_units import UnitSystem, shown_unit

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
    if unit.name == "mm" and named in _IN_UM:
        largest_um = _IN_UM[named] * max(abs(float(one)) for one in _EACH.findall(numbers))
        if largest_um < _LARGE_UM and (largest_um > 0.0 or named == "um"):
            shown, between = (_in_um(text, _IN_UM[named]) for text in (numbers, interval))
            return f"{shown} µm{between}"
    more = 1 if interval else 0  # so that the ends of a narrow interval still differ
    shown, between = (
        _EACH.sub(lambda one: _converted(one.group(), in_si / unit.in_si, more), text) for text in (numbers, interval)
    )
    return f"{shown} {unit.name}{between}"


def _in_um(numbers: str, factor: float) -> str:
    return numbers if factor == 1.0 else _EACH.sub(lambda one: f"{factor * float(one.group()):.3g}", numbers)


def _converted(number: str, factor: float, more: int) -> str:
    digits = more + len(re.sub(r"e.*|\D", "", number).lstrip("0"))
    value = float(number) * factor
    if 0.0 < abs(value) < _SMALL:
        return f"{value:.5f}"
    return plus_minus(value, None, digits=min(_DIGITS[1] + more, max(_DIGITS[0], digits)))
