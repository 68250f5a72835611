"""Nameplate files: TOML or a mapping becomes a Nameplate, or one sentence says what is wrong with it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import ConfigDict, TypeAdapter, ValidationError

from service.config.units import in_own_words, in_si
from service.words.spelling import lowered
from valve.errors import ConfigurationError, ParameterError, refuse
from valve.messages import Message, message_of, say
from valve.nameplate import Nameplate

# pydantic takes a configuration for an optional dataclass and hands it down; for a bare one it does not.
_ADAPTER: Final[TypeAdapter[Nameplate | None]] = TypeAdapter(Nameplate | None, config=ConfigDict(extra="forbid"))
_LARGEST_FILE_BYTES: Final = 65536

# Beyond these no control valve is built: the value is in another unit. Own choices, generous.
_LARGEST: Final = {
    "travel_m": (3.0, "m", "mm or percent"),
    "diaphragm_area_m2": (10.0, "m2", "cm2 or mm2"),
    "moving_mass_kg": (10_000.0, "kg", "g"),
}
_LOWEST_FULL_PRESSURE_PA: Final = 1_000.0


def read_nameplate(path: Path | str) -> Nameplate:
    """Nameplate of a TOML file as interface and docs describe it.

    Raises ConfigurationError with file, key, value and reason where it cannot be read, is no TOML, has an unknown
    key or a value of a wrong type, or states what no valve has.
    """
    source = str(path)
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise ConfigurationError(
            say("no_nameplate_file", "{source}: there is no such nameplate file, check its name", source=str(source))
        ) from None
    except IsADirectoryError:
        raise ConfigurationError(
            say("nameplate_is_folder", "{source}: it is a folder, give the nameplate's TOML file", source=str(source))
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            say("nameplate_unreadable", "{source}: it cannot be read: {why}", source=str(source), why=message_of(error))
        ) from None
    return nameplate_from_toml(data, source)


def nameplate_from_toml(data: bytes, source: str) -> Nameplate:
    """Nameplate of a TOML document; ``source`` names it in messages. Raises ConfigurationError."""
    if len(data) > _LARGEST_FILE_BYTES:
        raise ConfigurationError(
            say(
                "nameplate_too_large",
                "{source}: it has {count} bytes, a nameplate has at most {most}: give another file",
                source=str(source),
                count=len(data),
                most=_LARGEST_FILE_BYTES,
            )
        )
    try:
        mapping = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ConfigurationError(
            say("nameplate_no_utf8", "{source}: it is no text in UTF-8, save it as UTF-8", source=str(source))
        ) from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(
            say("nameplate_no_toml", "{source}: it is no TOML: {why}", source=str(source), why=message_of(error))
        ) from None
    return nameplate_from_mapping(mapping, source)


def nameplate_from_mapping(mapping: Mapping[str, Any], source: str) -> Nameplate:
    """Nameplate of ``{"tag", "actuator", "signal"}``, nested as in its TOML file; of types units alone are converted.

    Raises ConfigurationError with source, key, value and reason.
    """
    table = in_si(Nameplate, mapping)
    refuse(
        ConfigurationError,
        (
            say(
                "nameplate_fault",
                "{source}: {key} = {value}: {reason}: {remedy}",
                source=str(source),
                key=".".join(one.path),
                value=json.dumps(one.value, default=str),
                reason=one.reason,
                remedy=one.remedy,
            )
            for one in table.faults
        ),
    )
    try:
        return _nameplate(table.values, source, {".".join(path) for path in table.written})
    except ConfigurationError as error:
        raise ConfigurationError(in_own_words(message_of(error), table.written.items())) from None


def _nameplate(values: Mapping[str, Any], source: str, with_unit: Collection[str]) -> Nameplate:
    try:
        # through JSON: strict about types, and a list may still stand for a range
        nameplate = _ADAPTER.validate_json(json.dumps(dict(values), default=str), strict=True)
    except ValidationError as error:
        raise ConfigurationError(_of_source(source, _first_reason(error))) from None
    except (ParameterError, ValueError, RecursionError) as error:
        raise ConfigurationError(_of_source(source, message_of(error))) from None
    if nameplate is None:
        raise ConfigurationError(
            say("nameplate_empty", "{source}: it is empty, give tag and [actuator]", source=str(source))
        )
    _require_plausible(nameplate, source, with_unit)
    return nameplate


def _first_reason(error: ValidationError) -> str:
    """Key, value and reason of one of pydantic's findings: an unknown key before all, it is often the missing one."""
    unknown = ("extra_forbidden", "unexpected_keyword_argument")
    first = min(error.errors(include_url=False), key=lambda finding: finding["type"] not in unknown)
    key = ".".join(str(part) for part in first["loc"]) or "the document"
    if first["type"] in unknown:
        return say("unknown_key", "unknown key {key}: remove it or correct its name", key=key)
    if first["type"] in ("missing", "missing_argument"):
        return say("missing_key", "key {key} is missing: add it", key=key)
    shown = repr(first["input"])
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    return say("fault_of_value", "{key} is {shown}: {why}", key=key, shown=shown, why=lowered(first["msg"]))


def _of_source(source: str, why: str) -> Message:
    return say("of_nameplate", "{source}: {why}", source=str(source), why=why)


def _require_plausible(nameplate: Nameplate, source: str, with_unit: Collection[str]) -> None:
    """Raise ConfigurationError where a value looks like one in another unit; ``with_unit`` are keys that gave one."""
    faults: list[str] = []
    correct: str = say("correct_it", "correct it")
    for name, (limit, unit, looks) in _LARGEST.items():
        key, value = f"actuator.{name}", getattr(nameplate.actuator, name)
        if value is not None and value > limit:
            other = say(
                "looks_like_other_unit",
                "it looks like {looks}, write it in {unit} or with its unit",
                looks=looks,
                unit=unit,
            )
            faults.append(
                say(
                    "larger_than_any",
                    "{source}: {key} is {value:g} {unit}, no valve has more than {limit:g}: {remedy}",
                    source=str(source),
                    key=key,
                    value=value,
                    unit=unit,
                    limit=limit,
                    remedy=correct if key in with_unit else other,
                )
            )
    ranges = {
        "actuator.bench_set_pa": nameplate.actuator.bench_set_pa,
        "signal.range_pa": None if nameplate.signal is None else nameplate.signal.range_pa,
    }
    for key, span in ranges.items():
        if span is not None and max(abs(span[0]), abs(span[1])) < _LOWEST_FULL_PRESSURE_PA:
            other = say("looks_like_bar", "it looks like bar, psi or kPa, write it in Pa or with its unit")
            faults.append(
                say(
                    "lower_than_any",
                    "{source}: {key} is {low:g} to {high:g} Pa, no actuator works below {least:g}: {remedy}",
                    source=str(source),
                    key=key,
                    low=span[0],
                    high=span[1],
                    least=_LOWEST_FULL_PRESSURE_PA,
                    remedy=correct if key in with_unit else other,
                )
            )
    refuse(ConfigurationError, faults)
