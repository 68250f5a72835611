"""A message as a person reads it: made anew from its values, in that person's language, units and clock.

A text that is no message, such as one that an earlier version kept, stays as it was said: English and SI.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from functools import lru_cache
from typing import Final

from service.words.languages import Language, catalogue
from service.words.plain_numbers import as_read, digits_of, rounded
from service.words.units import UnitSystem, said_in, shown_unit
from valve.messages import ALONE, MINUTES, UNITS, Message, Value, as_told, fields, formed, parted

_KEPT: Final = 8192  # so many messages are kept as they were told
_MOST_FURTHER_DIGITS: Final = 6  # for an interval that is narrow beside its value
_SMALL_M: Final = 1.0e-4  # below it metric lengths are read in µm
_MICROMETRE: Final = "µm"
_PLACES: Final = "f"  # of a number with as many places whatever its size, as where a stem stands: it stays in mm


@dataclass(frozen=True, slots=True)
class Telling:
    """How a message is told: units, clock (None: UTC), language, and who tells the texts in it that are no messages."""

    system: UnitSystem
    zone: tzinfo | None
    language: Language
    plain: Callable[[str], str]

    def shown(self, message: Message) -> str:
        """Return a message with so many digits that numbers of a unit that differ in SI differ in these units too."""
        quantity = said_in(message, self.system)
        if quantity is not None:
            return formed(quantity, message.form)
        template = catalogue(self.language).template(message)
        parts = list(fields(template, message.values))
        numbers = [(message.values[name], spec) for _, name, spec in parts if name and parted(spec)[1]]
        in_um = self._is_in_um(numbers)
        more = 0
        while more < _MOST_FURTHER_DIGITS:
            alone = [(value, f"{parted(spec)[0]}{ALONE} {parted(spec)[1]}") for value, spec in numbers]
            told = {(spec, self._number(value, spec, in_um, more)) for value, spec in alone}
            if len(told) == len({(spec, as_told(value, spec)) for value, spec in alone}):
                break
            more += 1
        # German keeps the capital of a noun within a sentence
        form = "entry" if message.form == "clause" and self.language is not Language.ENGLISH else message.form
        return formed(
            "".join(
                text.replace("+-", "±") + ("" if name is None else self._value(message.values[name], spec, in_um, more))
                for text, name, spec in parts
            ),
            form,
        )

    def _value(self, value: Value, spec: str, in_um: bool, more: int) -> str:
        if isinstance(value, tuple):
            return catalogue(self.language).text(spec or "; ").join(self._value(one, "", in_um, more) for one in value)
        if isinstance(value, datetime):
            return as_told(value, spec) if self.zone is None else f"{value.astimezone(self.zone):{spec or MINUTES} %Z}"
        if isinstance(value, Message):
            return self.shown(value)
        return self.plain(value) if isinstance(value, str) else self._number(value, spec, in_um, more)

    def _number(self, value: Value, spec: str, in_um: bool, more: int) -> str:
        number, named, is_alone = parted(spec)
        unit = shown_unit(UNITS[named][0], self.system) if named else None
        name, factor = (named, 1.0) if unit is None else (unit.name, UNITS[named][1] / unit.in_si)
        if name == "mm" and in_um and not number.endswith(_PLACES):
            name, factor = _MICROMETRE, UNITS[named][1] / UNITS["um"][1]
        if unit is None or named in (name, "s", "ms", "%") or not isinstance(value, float | int):
            return as_read(as_told(value, spec))
        told = format(value / UNITS[named][1], number)
        digits = int(number[1:-1]) if number.endswith("g") and number[1:-1].isdigit() else digits_of(told)
        told = told if factor == 1.0 else rounded(value / UNITS[named][1] * factor, digits, more)
        return told if is_alone else f"{told} {name}"

    def _is_in_um(self, numbers: list[tuple[Value, str]]) -> bool:
        lengths_m = [
            (abs(value), parted(spec)[1])
            for value, spec in numbers
            if isinstance(value, float | int)
            and UNITS[parted(spec)[1]][0] == "m"
            and not parted(spec)[0].endswith(_PLACES)
        ]
        largest_m = max((length_m for length_m, _ in lengths_m), default=0.0)
        is_written_so = any(named == "um" for _, named in lengths_m)
        return largest_m < _SMALL_M and (largest_m > 0.0 or is_written_so)


def in_units(text: str, system: UnitSystem, zone: tzinfo | None = None, language: Language = Language.ENGLISH) -> str:
    """Return a message in the units of ``system``, its instants by ``zone``, in a language; ``+-`` is read as ``±``."""
    if isinstance(text, Message):
        return _told(_Made(text, _key(text)), system, zone, language)
    return as_read(text)


@dataclass(frozen=True, slots=True)
class _Made:
    """A message that is the same as another if it was made of the same: equal texts may hide other digits and codes."""

    message: Message = field(compare=False)
    key: Hashable


def _key(value: Value) -> Hashable:
    if isinstance(value, Message):
        return value.code, value.template, value.form, tuple((name, _key(one)) for name, one in value.values.items())
    return tuple(map(_key, value)) if isinstance(value, tuple) else value


@lru_cache(maxsize=_KEPT)
def _told(made: _Made, system: UnitSystem, zone: tzinfo | None, language: Language) -> str:
    """Lists say the same again and again."""
    return Telling(system, zone, language, as_read).shown(made.message)
