"""Headers of a table: which quantity a name speaks of, in the languages of its writers, and in which unit."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Any, Final


class Quantity(StrEnum):
    """What a column of a recording may be."""

    TIME = "time"
    POSITION = "position"
    PRESSURE = "pressure"
    FORCE = "force"
    COMMAND = "command"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit by its name in the file: its dimension and its size in SI (mA for a current, 1 for a percent)."""

    text: str
    dimension: str  # "time", "length", "pressure", "force", "current", "percent", or one that no column has
    factor: float
    absolute: bool = False  # a pressure that is counted from vacuum by its name


#: The dimensions that a column of each quantity may have.
DIMENSIONS: Final[dict[Quantity, tuple[str, ...]]] = {
    Quantity.TIME: ("time",),
    Quantity.POSITION: ("length", "percent"),
    Quantity.PRESSURE: ("pressure",),
    Quantity.FORCE: ("force",),
    Quantity.COMMAND: ("current", "percent", "pressure"),
}
#: What a column without a unit is asked for, in the order in which they are usual.
USUAL: Final[dict[Quantity, tuple[str, ...]]] = {
    Quantity.TIME: ("s", "ms"),
    Quantity.POSITION: ("%", "mm", "m", "in"),
    Quantity.PRESSURE: ("bar", "psi", "kPa", "Pa"),
    Quantity.FORCE: ("N", "kN", "lbf"),
    Quantity.COMMAND: ("mA", "%", "bar", "psi", "kPa", "Pa"),
}


def _split(words: str) -> frozenset[str]:
    return frozenset(words.split())


_WORDS: Final[dict[Quantity, frozenset[str]]] = {
    Quantity.TIME: _split(
        "time t zeit uhrzeit messzeit timestamp zeitstempel datetime date datum elapsed temps heure horodatage tiempo "
        "hora fecha tempo tijd tid czas"
    ),
    Quantity.POSITION: _split(
        "position pos travel stem stroke lift displacement opening hub stellung ventilstellung istposition weg "
        "rueckmeldung ruckmeldung feedback lvdt course ouverture carrera apertura recorrido posicion corsa posizione "
        "slag skok"
    ),
    Quantity.PRESSURE: _split("pressure press druck stelldruck pression presion pressione p druk cisnienie"),
    Quantity.FORCE: _split("force thrust kraft load loadcell fuerza forza effort kracht sila"),
    Quantity.COMMAND: _split(
        "command cmd signal setpoint sp sollwert sollposition soll stellsignal stellgrosse stellgroesse output op mv "
        "demand reference consigne commande consigna segnale current strom"
    ),
}
_GERMAN_ENDS: Final = {
    "hub": Quantity.POSITION,
    "weg": Quantity.POSITION,
    "stellung": Quantity.POSITION,
    "druck": Quantity.PRESSURE,
    "kraft": Quantity.FORCE,
    "zeit": Quantity.TIME,
    "sollwert": Quantity.COMMAND,
    "signal": Quantity.COMMAND,
}
# A wish, whatever it is of: "position setpoint", "command pressure".
_WISHES: Final = _split("command cmd setpoint sp sollwert sollposition soll stellsignal demand consigne reference")
_WEAK: Final = _split("stem current signal")  # "stem force", "position signal": the other word says what it is
# Of another place than the actuator, or no value that a recording has.
_OTHERS: Final = _split(
    "supply zuluft versorgung vordruck nachdruck upstream downstream inlet outlet line process differential dp p1 p2 "
    "temperature temp temperatur deviation error abweichung regelabweichung velocity speed geschwindigkeit rate alarm "
    "quality status qualitat qualitaet index sample counter noise ambient barometric flow durchfluss level"
)
_UNITS: Final[dict[str, str]] = {  # a spelling, small letters, and what pint calls it
    "s": "second", "sec": "second", "secs": "second", "second": "second", "seconds": "second", "sek": "second",
    "sekunde": "second", "sekunden": "second", "ms": "millisecond", "msec": "millisecond",
    "millisecond": "millisecond", "milliseconds": "millisecond", "millisekunden": "millisecond",
    "us": "microsecond", "usec": "microsecond", "µs": "microsecond", "ns": "nanosecond", "min": "minute",
    "minutes": "minute", "minuten": "minute", "h": "hour", "hr": "hour", "hours": "hour", "days": "day",
    "m": "meter", "meter": "meter", "metre": "meter", "mm": "millimeter", "millimeter": "millimeter",
    "millimetre": "millimeter", "cm": "centimeter", "µm": "micrometer", "um": "micrometer", "in": "inch",
    "inch": "inch", "inches": "inch", "zoll": "inch", '"': "inch", "″": "inch", "''": "inch",
    "pa": "pascal", "hpa": "hectopascal", "kpa": "kilopascal", "mpa": "megapascal", "bar": "bar", "mbar": "millibar",
    "psi": "psi", "lb/in2": "psi", "kg/cm2": "kilogram_force / centimeter ** 2",
    "kgf/cm2": "kilogram_force / centimeter ** 2", "kp/cm2": "kilogram_force / centimeter ** 2",
    "ksc": "kilogram_force / centimeter ** 2", "inh2o": "inch_H2O", "inwc": "inch_H2O",
    "torr": "torr", "lbf/in2": "psi",
    "thou": "thou", "mil": "thou", "mils": "thou",
    "mmh2o": "kilogram_force / meter ** 2", "mmws": "kilogram_force / meter ** 2", "mmhg": "mmHg",
    "n": "newton", "newton": "newton", "kn": "kilonewton", "lbf": "pound_force", "lbs": "pound_force",
    "kgf": "kilogram_force", "kp": "kilogram_force", "ma": "milliampere", "a": "ampere", "v": "volt", "mv": "millivolt",
    "deg": "degree", "degree": "degree", "degrees": "degree", "°": "degree", "grad": "degree", "rad": "radian",
    "°c": "delta_degC", "degc": "delta_degC", "°f": "delta_degF", "degf": "delta_degF", "k": "kelvin", "hz": "hertz",
}  # fmt: skip
_PERCENT: Final = frozenset(
    {"%", "percent", "pct", "prozent", "% open", "% travel", "% of travel", "% span", "% of span", "%fs", "pc", "perc"}
)
_DIMENSIONS: Final = (  # pint's name of a dimension, ours, and what one SI unit of it is in ours
    ("[time]", "time", 1.0),
    ("[length]", "length", 1.0),
    ("[pressure]", "pressure", 1.0),
    ("[force]", "force", 1.0),
    ("[current]", "current", 1.0e3),
    ("[electric_potential]", "voltage", 1.0),
    ("[temperature]", "temperature", 1.0),
    ("[frequency]", "frequency", 1.0),
    ("[]", "angle", 1.0),
)
_ONE_LETTER: Final = frozenset({"s", "m", "n", "%"})  # of a unit that stands behind an underscore: position_m
_MEASURED_CELL: Final = re.compile(r"([+-]?[\d.,' ]*\d(?:[eE][+-]?\d+)?)\s*([^\d\s.,'+-][^\d]{0,9}2?)")
_BRACKETS: Final = re.compile(r"\s*(?:\[([^\[\]]*)\]|\{([^{}]*)\}|<([^<>]*)>|\(((?:[^()]|\([^()]*\))*)\))\s*$")


def unit_of(text: str) -> Unit | None:
    """Return the unit of this name, None where it is none that a recording may have."""
    name = text.strip().strip("[](){}").strip() if not re.search(r"\([^()]*\)$", text.strip()) else text.strip()
    return _unit_of(name)


@lru_cache(maxsize=512)
def _unit_of(text: str) -> Unit | None:
    name = _spelled(text)
    if not name or len(name) > 24:
        return None
    if name in _PERCENT:
        return Unit("%", "percent", 1.0)
    name, absolute = pint_name(text)
    try:
        dimension, factor = _measured(name)
    except ValueError:
        return None
    return Unit(text.strip(), dimension, factor, absolute)


def pint_name(text: str) -> tuple[str, bool]:
    """Return what pint calls a unit of this spelling, and whether it is a pressure that counts from vacuum."""
    name, absolute = _spelled(text), False
    if name not in _UNITS:
        gauge = re.fullmatch(r"(.+?)[ _]?\(?(g|a|abs|gauge|ga|e|ü)\)?", name)
        if gauge is not None and gauge[1] in _UNITS and _measured(_UNITS[gauge[1]])[0] == "pressure":
            name, absolute = gauge[1], gauge[2] in ("a", "abs")
    return _UNITS.get(name, text.strip()), absolute


def _spelled(text: str) -> str:
    name = text.strip().casefold().replace("μ", "µ").replace("²", "2").replace("^2", "2").replace("**2", "2")
    return name.rstrip(".")


@lru_cache(maxsize=1)
def registry() -> Any:
    """Return pint's units, one for all: pint takes half a second to set them up."""
    import pint  # noqa: PLC0415  - a file in SI units needs none

    return pint.UnitRegistry()


@lru_cache(maxsize=512)
def _measured(name: str) -> tuple[str, float]:
    """Return dimension and factor of a unit that pint knows. Raises ValueError where it is none of ours."""
    if not re.fullmatch(r"[A-Za-zµ°_][A-Za-z0-9µ°_ */]*", name):
        raise ValueError(name)
    try:
        quantity = registry().Quantity(1.0, registry().Unit(name)).to_base_units()
    except Exception as error:
        raise ValueError(name) from error
    found = next(((ours, scale) for theirs, ours, scale in _DIMENSIONS if quantity.check(theirs)), None)
    if found is None:
        raise ValueError(name)
    dimension, scale = found
    factor = float(quantity.magnitude) * scale
    if not 1.0e-10 < factor < 1.0e8:
        raise ValueError(name)
    return dimension, factor


def number_and_unit(cell: str) -> tuple[str, str] | None:
    """Return number and unit of a cell such as ``12.5 psi`` or ``45 %``; None where it is no such cell."""
    found = _MEASURED_CELL.fullmatch(cell)
    return (found[1], found[2]) if found is not None and unit_of(found[2]) is not None else None


def is_unit(text: str) -> bool:
    """Whether a cell names a unit."""
    return unit_of(text) is not None


def without_unit(header: str) -> tuple[str, str]:
    """Return a header's name, and the unit that stands with it, "" where none does."""
    header = header.strip()
    found = _BRACKETS.search(header)
    if found is not None and found.start() > 0:
        inside = next(group for group in found.groups() if group is not None)
        return header[: found.start()].strip(), inside.strip() if unit_of(inside) else ""
    parted = re.fullmatch(r"(.*\S)\s*(?:/|,|\s-\s|\bin\b)\s*(\S.*)", header)
    if parted is not None and unit_of(parted[2]):
        return parted[1], parted[2]
    for text in (header, re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])", "_", header)):  # then "PositionMM"
        parted = re.fullmatch(r"(.*[^\s_.-])([\s_.-]+)(\S+)", text)
        if parted is None or not unit_of(parted[3]):
            continue
        short = len(parted[3]) == 1 and not (parted[2] == "_" and parted[3] in _ONE_LETTER) and parted[3] != "%"
        if not short:
            return parted[1], parted[3]
    return header, ""


def quantities(header: str) -> tuple[Quantity, ...]:
    """Return what a header may speak of: nothing, one quantity, or several that it fits."""
    words = _words(without_unit(header)[0])
    hits = {quantity for quantity, own in _WORDS.items() if words & own}
    hits |= {quantity for end, quantity in _GERMAN_ENDS.items() for word in words if len(word) > len(end) and
             word.endswith(end)}  # fmt: skip
    if len(hits) > 1 and words & _WISHES:
        return (Quantity.COMMAND,)
    if len(hits) > 1:
        strong = {quantity for quantity in hits if (words & _WORDS[quantity]) - _WEAK or not words & _WORDS[quantity]}
        hits = strong or hits
    return tuple(quantity for quantity in Quantity if quantity in hits)


def is_of_another_place(header: str) -> bool:
    """Whether a header speaks of what is no channel of a recording, such as a supply's pressure or a temperature."""
    words = _words(without_unit(header)[0])
    return bool(words & _OTHERS) or any(word.startswith(("zuluft", "versorgung")) for word in words)


def _words(name: str) -> set[str]:
    split = re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])", " ", name).casefold()
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", split) if not unicodedata.combining(letter))
    plain = plain.replace("ß", "ss")
    return set(re.findall(r"[^\W_]+", plain))
