"""``[[valves]]`` in plant.toml: each part by itself, so that one that is wrong hides no other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from drivers.addresses import Mode, MotionLimits, Point, Sampling, ValveWiring, WatchdogChoice, safe_value_fault
from drivers.permissive_rules import PermissiveRules
from drivers.register_map import RegisterMap
from drivers.stands_at import RestRules
from service.config.errors import TEXT, Findings, Key
from service.config.maps import without_wrong
from service.config.nameplates import nameplate_from_mapping
from service.config.permissives import stem_rules_of
from service.config.plant import Identity
from service.config.safe_value import SafeValue, rest_rules
from service.config.watching import watch_rules
from valve.errors import ConfigurationError, ValveError
from valve.nameplate import Actuator, Nameplate, Signal

_Part = TypeVar("_Part")
_SAFE_VALUE: TypeAdapter[SafeValue] = TypeAdapter(SafeValue)


def _one_line(value: str) -> str:
    if not value.isprintable():
        raise PydanticCustomError(TEXT, "it has a character that cannot be shown")
    return value


_Text = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]


class ValveSection(BaseModel):
    """One ``[[valves]]``, its parts still as they stand in the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    tag: Annotated[str, Field(min_length=1, max_length=64)]
    limits_class: Annotated[str | None, Field(alias="class")] = None
    description: _Text | None = None
    area: _Text | None = None
    service: _Text | None = None
    manufacturer: _Text | None = None
    model: _Text | None = None
    serial_number: _Text | None = None
    safe_value_pa: SafeValue
    safe_position_m: float | None = None
    safe_position_tolerance_m: float | None = None
    stem_read_after_s: float | None = None
    actuator: dict[str, Any]
    limits: dict[str, Any]
    command: dict[str, Any]
    acquisition: dict[str, Any]
    signal: dict[str, Any] | None = None
    position: dict[str, Any] | None = None
    pressure: dict[str, Any] | None = None
    watchdog: dict[str, Any] | None = None
    permissives: dict[str, Any] | None = None
    watch: dict[str, Any] | None = None
    health: dict[str, Any] | None = None
    simulation: dict[str, Any] | None = None  # for `breakaway simulate` alone: a service has no use for it


@dataclass(frozen=True, slots=True)
class ValveParts:
    """What could be read of one valve; None where a part is absent or wrong, which is noted.

    ``wiring`` is there where its places and limits are right, so that it can be judged; where another part of it is
    wrong, something harmless stands in for that.
    """

    key: Key
    tag: str
    identity: Identity
    nameplate: Nameplate | None
    limits: MotionLimits | None
    signal: Signal | None
    permissives: PermissiveRules | None
    points: dict[str, Point]  # by their key: command, position, pressure
    wiring: ValveWiring | None
    maps: Mapping[str, RegisterMap | None]  # the plant's own by name, None where one is wrong
    limits_class: str = ""
    acquisition: Sampling | None = None


def valve_parts(
    findings: Findings, raw: dict[str, Any], key: Key, own_maps: Mapping[str, RegisterMap | None] | None = None
) -> ValveParts:
    """Return one valve as far as it can be read, with every fault noted; ``own_maps`` are the plant's own."""
    maps = own_maps or {}
    raw = findings.si_table(ValveSection, raw, key)
    section = findings.model(ValveSection, raw, key)
    names = [one.name for one in fields(Identity)]
    identity = Identity() if section is None else Identity(**{name: getattr(section, name) for name in names})
    tag = raw["tag"] if isinstance(raw.get("tag"), str) else ""

    def part(kind: type[_Part], name: str) -> _Part | None:
        """A part that is there; what is no table, or missing, is told with the whole."""
        given = raw.get(name)
        counted = {"quantity": "_m" if name == "position" else "_pa"}  # of a point, its own or of the permissives
        return findings.part(kind, given, (*key, name), counted) if isinstance(given, dict) else None

    actuator, signal = part(Actuator, "actuator"), part(Signal, "signal")
    limits, sampling, watchdog = (
        part(MotionLimits, "limits"),
        part(Sampling, "acquisition"),
        part(WatchdogChoice, "watchdog"),
    )
    given = {name: part(Point, name) for name in ("command", "position", "pressure")}
    points = {name: point for name, point in given.items() if point is not None}
    rules = part(PermissiveRules, "permissives") if "permissives" in raw else PermissiveRules()
    nameplate = None
    if actuator is not None and (signal is not None) == ("signal" in raw) and tag:
        plate: dict[str, Any] = {name: raw[name] for name in ("tag", "actuator", "signal") if name in raw}
        try:
            nameplate = nameplate_from_mapping(plate, tag)
        except ValveError as error:
            findings.add_error(key, error)
    if rules is not None and nameplate is not None:
        rules = stem_rules_of(rules, nameplate)
    rest = None
    if nameplate is not None and limits is not None and rules is not None:
        rest = rest_rules(
            findings,
            key,
            nameplate,
            limits,
            rules,
            position_m=_number(raw.get("safe_position_m")),
            tolerance_m=_number(raw.get("safe_position_tolerance_m")),
            after_s=_number(raw.get("stem_read_after_s")),
        )
    safe_value_pa, wiring = _safe_value_pa(raw.get("safe_value_pa")), None
    misplaced = "" if safe_value_pa is None or limits is None else safe_value_fault(tag, safe_value_pa, limits)
    if misplaced:
        findings.add_error(key, ConfigurationError(misplaced))
    watch = watch_rules(findings, raw.get("watch"), (*key, "watch"))
    is_placed = "command" in points and all(raw.get(name) is None or name in points for name in given)
    used = {point.map for point in (*points.values(), *(() if rules is None else rules.points))}
    is_placed &= not any(maps.get(name or "", ...) is None for name in used)
    if is_placed and limits is not None:
        # What is wrong in itself is told already; in its stead stands what nothing can be said against.
        if watchdog is None:
            watchdog = WatchdogChoice(waived="wrong") if "watchdog" in raw else WatchdogChoice(timeout_s=2.0)
        wiring = ValveWiring(
            tag,
            points["command"],
            "entry" if safe_value_pa is None or misplaced else safe_value_pa,
            limits,
            sampling or Sampling(Mode.POLLED, 1.0e-3),
            points.get("position"),
            points.get("pressure"),
            watchdog,
            PermissiveRules() if rules is None else rules,
            rest or RestRules(),
            without_wrong(maps),
            watch,
        )
    of_class = "" if section is None else section.limits_class or ""
    return ValveParts(key, tag, identity, nameplate, limits, signal, rules, points, wiring, maps, of_class, sampling)


def _safe_value_pa(given: object) -> SafeValue | None:
    try:
        return _SAFE_VALUE.validate_python(given)
    except ValidationError:
        return None  # told with the whole


def _number(given: object) -> float | None:
    """Return a number; what is none is told with the whole."""
    is_number = isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given)
    return given if isinstance(given, int | float) and is_number else None
