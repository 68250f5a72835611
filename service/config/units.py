"""Values with units in plant.toml and nameplates: ``travel = "4 in"`` becomes ``travel_m = 0.1016``.

A key that ends in a unit, such as ``travel_m``, may be written without that end and with a string, or a list of strings
for a range. This is done before a table is checked, so the check sees SI keys alone; what it finds is told by the name
and the value that stand in the file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from types import UnionType
from typing import Annotated, Any, Final, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel

from service.own_files.names import pint_name, registry, unit_of
from valve.messages import Message, changed, message_of, say

Path = tuple[str, ...]
_NONE: Final[Mapping[str, str]] = {}


class _Unit(NamedTuple):
    """What the end of a key stands for: pint's unit, the quantity in words, and units that people write."""

    pint: str
    words: str
    usual: tuple[str, ...]


_ENDS: Final = {  # the longest first: limits.pressure_rate_pa_per_s is no time
    "_pa_per_s": _Unit("pascal / second", "change of pressure in time", ("psi/s", "bar/s", "kPa/s", "Pa/s")),
    "_per_s": None,  # a count a second, which needs no other unit
    "_percent": _Unit("percent", "percentage", ("%",)),
    "_days": _Unit("day", "time", ("d", "h", "min", "s")),
    "_pa": _Unit("pascal", "pressure", ("psi", "bar", "kPa", "Pa")),
    "_m2": _Unit("meter ** 2", "area", ("in2", "cm2", "mm2", "m2")),
    "_kg": _Unit("kilogram", "mass", ("lb", "kg", "g")),
    "_ma": _Unit("milliampere", "current", ("mA", "A")),
    "_hz": _Unit("hertz", "frequency", ("Hz",)),
    "_m": _Unit("meter", "length", ("in", "mm", "cm", "m")),
    "_s": _Unit("second", "time", ("s", "ms", "min", "h")),
    "_n": _Unit("newton", "force", ("lbf", "kN", "N")),
}
_DECIMAL: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_NUMBER: Final = re.compile(rf"({_DECIMAL})\s*(.*)")
_RANGE: Final = re.compile(rf"({_DECIMAL})\s*(\D*?)\s*(?:\bto\b|\.\.+|…|–|-|/)\s*({_DECIMAL})\s*(.*)")
_FACTOR: Final = re.compile(r"([A-Za-zµμ°\"″]+)(?:\^|\*\*)?([23])?")
_DIGITS: Final = 12  # of a converted value: 4 in are 0.1016 m, without what the machine's arithmetic adds


@dataclass(frozen=True, slots=True)
class Written:
    """A key as it stands in the file, where the check sees its SI key."""

    name: str
    value: object


@dataclass(frozen=True, slots=True)
class UnitFault:
    """A value that cannot be taken: where it stands, which SI keys it leaves open, why, and what to do."""

    path: Path
    value: object
    si_names: Path
    reason: str
    remedy: str


@dataclass(frozen=True, slots=True)
class SiTable:
    """A table with its SI keys alone; ``written`` has by their path in it those that stood there with a unit."""

    values: dict[str, Any]
    written: Mapping[Path, Written]
    faults: tuple[UnitFault, ...]


class _NoValueError(Exception):
    """A string that is no value with a fitting unit."""


def in_si(kind: Any, raw: Mapping[str, Any], ends: Mapping[str, str] = _NONE) -> SiTable:
    """Return a table that a dataclass or a pydantic model describes, with its values in the units of its keys.

    ``ends`` has what keys without a unit in their names count, as the end that they could have ("_pa"). What has no
    fitting unit, or stands there twice, is left out and told as a fault; nothing is raised.
    """
    values: dict[str, Any] = {}
    written: dict[Path, Written] = {}
    faults: list[UnitFault] = []
    keys, tables = own_names(kind), _tables(kind)
    for name, value in raw.items():
        if name in tables and isinstance(value, Mapping):
            inner = in_si(tables[name], value, ends)
            values[name] = inner.values
            written |= {(name, *path): one for path, one in inner.written.items()}
            faults += (UnitFault((name, *one.path), *_rest(one)) for one in inner.faults)
        elif name in ends and _is_text(value):
            try:
                values[name] = _converted(value, _unit(ends[name]), ())
            except _UnfittingError as error:
                faults.append(
                    UnitFault((name,), value, (name,), error.of(_unit(ends[name]).words), _advice((ends[name],)))
                )
            else:
                written[(name,)] = Written(name, value)
        elif name in keys and _is_for_us(value):
            try:
                si_name, si_value = _taken(kind, keys[name], value, raw)
            except _NoValueError as error:
                faults.append(UnitFault((name,), value, tuple(keys[name]), *error.args))
            else:
                values[si_name] = si_value
                written[(si_name,)] = Written(name, value)
        else:
            values[name] = value
    return SiTable(values, written, tuple(faults))


def as_value(text: str, unit: str = "") -> Any:
    """Return what a person wrote outside of TOML as it would stand there: "3 to 15 psi" as ["3 psi", "15 psi"].

    ``unit`` is that of a number which stands alone; without one a number is a number. What is neither stays a text.
    """
    ends = _RANGE.fullmatch(text)
    if ends is not None:
        low, low_unit, high, high_unit = (one.strip() for one in ends.groups())
        return [_end_of(low, low_unit or high_unit or unit), _end_of(high, high_unit or unit)]
    return _end_of(text, unit) if re.fullmatch(_DECIMAL, text) else text


def _end_of(number: str, unit: str) -> Any:
    if unit:
        return f"{number} {unit}"
    return int(number) if re.fullmatch(r"[-+]?\d+", number) else float(number)


def in_own_words(text: str, written: Iterable[tuple[Path, Written]]) -> str:
    """Return a message with each value that is an SI key by the name and the value that stand in the file."""
    known = [(path, one) for path, one in written if path[-1] != one.name]
    return changed(text, lambda one: one if isinstance(one, Message) else _in_own_words(one, known))


def _in_own_words(value: str, written: Iterable[tuple[Path, Written]]) -> str:
    table, _, name = value.rpartition(".")
    for path, one in written:
        if path[-1] == name and (not table or path[-2:-1] in ((), (table,))):
            own = f"{table}.{one.name}" if table else one.name
            return say("own_key", "{key} ({value})", key=own, value=json.dumps(one.value, ensure_ascii=False))
    return value


@lru_cache(maxsize=128)
def own_names(kind: Any) -> dict[str, tuple[str, ...]]:
    """Return the names under which a table takes values with units, each with the SI keys that it may stand for."""
    known = hints_of(kind)
    names: dict[str, tuple[str, ...]] = {}
    for si_name in known:
        end = _end(si_name)
        name = si_name.removesuffix(end)
        if end and name not in known:  # permissives.supply is a table of its own beside supply_pa
            names[name] = (*names.get(name, ()), si_name)
    return names


def _rest(fault: UnitFault) -> tuple[object, Path, str, str]:
    return fault.value, fault.si_names, fault.reason, fault.remedy


def _end(si_name: str) -> str:
    end = next((end for end in _ENDS if si_name.endswith(end)), "")
    return end if _ENDS.get(end) is not None else ""


def _unit(si_name: str) -> _Unit:
    unit = _ENDS[_end(si_name)]
    assert unit is not None  # own_names takes no other
    return unit


@lru_cache(maxsize=128)
def hints_of(kind: Any) -> dict[str, Any]:
    """Return the annotations of what a table has, by its keys."""
    if is_dataclass(kind):
        known = {one.name: one.name for one in fields(kind)}
    elif isinstance(kind, type) and issubclass(kind, BaseModel):
        known = {one.alias or name: name for name, one in kind.model_fields.items()}
    else:
        return {}
    hints = get_type_hints(kind, include_extras=True)
    return {key: hints[name] for key, name in known.items()}


def types_in(hint: Any) -> Iterator[Any]:
    """Yield the types that an annotation allows."""
    if get_origin(hint) is Annotated:
        yield from types_in(get_args(hint)[0])
    elif get_origin(hint) in (Union, UnionType, tuple, list):
        for one in get_args(hint):
            yield from types_in(one)
    else:
        yield hint


@lru_cache(maxsize=128)
def _tables(kind: Any) -> dict[str, Any]:
    """Return what describes the tables inside a table, by their keys."""
    found = {
        name: next((one for one in types_in(hint) if hints_of(one)), None) for name, hint in hints_of(kind).items()
    }
    return {name: one for name, one in found.items() if one is not None}


def _is_for_us(value: object) -> bool:
    """Whether a value is one with a unit, or lacks one; anything else is an unknown key."""
    ends = value if isinstance(value, list) and value else [value]
    return all(isinstance(one, str | int | float) and not isinstance(one, bool) for one in ends)


def _is_text(value: object) -> bool:
    return _is_for_us(value) and all(isinstance(one, str) for one in (value if isinstance(value, list) else [value]))


def _taken(kind: Any, si_names: Path, value: Any, raw: Mapping[str, Any]) -> tuple[str, Any]:
    """Return which SI key a value stands for, and its value there. Raises _NoValueError with reason and remedy."""
    if not _is_text(value):
        raise _NoValueError(
            say("number_alone", "a number alone, its unit is unknown"),
            say("or_give_key", "{advice}, or give {keys: or }", advice=_advice(si_names), keys=tuple(si_names)),
        )
    for si_name in si_names:
        parts = list(types_in(hints_of(kind)[si_name]))
        words = [word for one in parts if get_origin(one) is Literal for word in get_args(one)]
        if value in words:
            return _alone(si_name, value, raw)  # a word that the key takes: safe_value = "entry"
        try:
            return _alone(si_name, _converted(value, _unit(si_name), parts), raw)
        except _UnfittingError as error:
            if si_name != si_names[-1]:
                continue
            wanted = " and no ".join(dict.fromkeys(_unit(one).words for one in si_names))
            advice = _advice(si_names)
            for word in words:
                advice = say("or_word", '{advice}, or "{word}"', advice=advice, word=word)
            raise _NoValueError(error.of(wanted), advice) from None
    raise AssertionError(si_names)  # there is at least one


def _alone(si_name: str, value: Any, raw: Mapping[str, Any]) -> tuple[str, Any]:
    if si_name in raw:
        raise _NoValueError(
            say("given_too", "{key} is given too", key=si_name), say("give_one_of_two", "give one of the two")
        )
    return si_name, value


def _advice(si_names: Path) -> Message:
    usual = [unit for si_name in si_names for unit in _unit(si_name).usual]
    listed = usual[0] if len(usual) == 1 else f"{', '.join(usual[:-1])} or {usual[-1]}"
    return say(
        "write_with_unit", 'write it with a unit such as {units}, in quotes: "6 {unit}"', units=listed, unit=usual[0]
    )


class _UnfittingError(Exception):
    """A string without a fitting unit; its reason has a place for the quantity that is wanted."""

    def of(self, wanted: str) -> str:
        """Return the reason, where this quantity is wanted."""
        said = message_of(self)
        if not isinstance(said, Message):
            return said
        return Message(said.code, said.template, {**said.values, "wanted": wanted}, said.form)


def _converted(value: Any, unit: _Unit, types: Collection[Any]) -> Any:
    """Return a string, or a list of them, in this unit. Raises _UnfittingError."""
    si: list[float] = [_si_value(one, unit) for one in (value if isinstance(value, list) else [value])]
    if int in types and float not in types:
        si = [round(one) if one == round(one) else one for one in si]
    return si if isinstance(value, list) else si[0]


def _si_value(text: str, unit: _Unit) -> float:
    """Return a number with its unit in the unit of its key. Raises _UnfittingError."""
    found = _NUMBER.fullmatch(text.strip())
    if found is None or re.match(r"[\d.,/]", found[2]):
        raise _UnfittingError(say("no_number_with_unit", "it is no decimal number with a unit"))
    number, name = float(found[1]), found[2].strip()
    if not name:
        raise _UnfittingError(say("has_no_unit", "it has no unit"))
    shown = name[:40]
    is_no = say("unit_is_no", "{unit} is no {wanted}", unit=shown, wanted="")
    if unit.pint == "percent" or name == "%":
        known = unit_of(name)
        if unit.pint == "percent" and known is not None and known.dimension == "percent":
            return number
        raise _UnfittingError(is_no)
    if pint_name(name)[1]:
        raise _UnfittingError(
            say("counts_from_vacuum", "{unit} counts from vacuum, pressures here count from the air around", unit=shown)
        )
    scale = _scale(name, unit.pint)
    if scale is None:
        raise _UnfittingError(say("unit_is_unknown", "the unit {unit} is unknown", unit=shown))
    if scale == 0.0:
        raise _UnfittingError(is_no)
    return float(f"{number * scale:.{_DIGITS}g}")


@lru_cache(maxsize=512)
def _scale(name: str, wanted: str) -> float | None:
    """Return how many of the wanted unit one of this name is; 0 where it measures another thing, None where unknown."""
    import pint  # noqa: PLC0415  - a file in SI units needs none

    is_known = False
    for spelled in _spellings(name):
        try:
            return float(registry().Quantity(1.0, registry().parse_units(spelled)).to(wanted).magnitude)
        except pint.UndefinedUnitError:
            continue
        except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
            is_known = True
    return 0.0 if is_known else None


def _spellings(name: str) -> Iterator[str]:
    """Yield what pint may call a unit: as files spell it, then as it stands, then in small letters."""
    whole = pint_name(name)[0]
    if whole != name:
        yield whole
    plain = name.replace("²", "2").replace("³", "3").replace("·", "*").rstrip(".")
    plain = re.sub(r"(?i)^(?:sq\.?|square)\s*([a-z]+)\.?$", r"\g<1>2", plain)
    factors = [_FACTOR.fullmatch(one.strip()) for one in re.split(r"(?<!\*)[*/](?!\*)", plain)]
    if any(one is None for one in factors):
        return
    signs = [*re.findall(r"(?<!\*)[*/](?!\*)", plain), ""]
    for spelled in (lambda word: pint_name(word)[0], str, str.casefold):
        yield "".join(
            f"({spelled(one[1])}) ** {one[2] or 1} {sign} "
            for one, sign in zip(factors, signs, strict=True)
            if one is not None
        )
