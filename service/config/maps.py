"""``[[maps]]`` in plant.toml: register maps of devices that need no Python code, judged as those of the drivers are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from drivers.capabilities import Role, Watchdog
from drivers.map_faults import map_faults
from drivers.maps import REGISTER_MAPS
from drivers.register_map import Canary, RegisterMap
from drivers.registers import Kind, Register, Table, WordOrder
from service.config.errors import Findings, Key
from valve.errors import ConfigurationError
from valve.messages import say
from valve.units import SI_FACTORS

_STRICT: Final = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
_SIGNALS: Final = ("A", "V", "1")  # a valve says by signal and quantity what they stand for
_Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+$")]


class RegisterSection(BaseModel):
    """One ``[[maps.registers]]``. The value is ``scale * raw + offset`` in ``unit``; ``address`` counts from 0."""

    model_config = _STRICT
    name: _Name
    address: int = Field(ge=0, le=0xFFFF)
    kind: Kind
    table: Table = Table.HOLDING
    unit: str = "1"
    scale: float = 1.0
    offset: float = 0.0
    word_order: WordOrder | None = None
    writable: bool = False
    raw_range: tuple[float, float] | None = None
    role: Role | None = None
    readback: _Name | None = None
    status: _Name | None = None
    meaning: str = ""


class CanarySection(BaseModel):
    """``[maps.canary]``: the register that proves which device answers, and its value in the register's unit."""

    model_config = _STRICT
    register_name: _Name = Field(alias="register")
    expected: float
    differs: bool = False


class WatchdogSection(BaseModel):
    """``[maps.watchdog]``: registers of the device's watchdog, and the values of its state."""

    model_config = _STRICT
    timeout: _Name
    heartbeat: _Name
    safe_value: _Name
    state: _Name
    armed: int
    tripped: int
    run: _Name | None = None


class MapSection(BaseModel):
    """One ``[[maps]]``. ``word_order`` is that of every value of two registers which names none.

    With ``like`` it is a map of the drivers in another word order, or written by another function.
    """

    model_config = _STRICT
    name: _Name
    source: str = Field(min_length=1, max_length=200)
    like: str | None = None
    registers: Annotated[list[dict[str, Any]], Field(min_length=1)] | None = None
    word_order: WordOrder | None = None
    write_function: Literal[6, 16] | None = None
    is_positioner: bool | None = None
    canary: dict[str, Any] | None = None
    watchdog: dict[str, Any] | None = None
    number: _Name | None = None


def own_maps(findings: Findings, sections: Sequence[dict[str, Any]]) -> dict[str, RegisterMap | None]:
    """Return the plant's own register maps by name, None where one is wrong, which is noted."""
    maps: dict[str, RegisterMap | None] = {}
    for index, raw in enumerate(sections):
        key: Key = ("maps", index)
        before, name = len(findings), raw.get("name")
        made = _map(findings, raw, key)
        if isinstance(name, str):
            if name in REGISTER_MAPS:
                findings.add(
                    (*key, "name"),
                    name,
                    say("drivers_device_has_name", "a device of the drivers has this name"),
                    say("choose_another", "choose another"),
                )
            elif name in maps:
                findings.add(
                    (*key, "name"),
                    name,
                    say("other_map_has_name", "another map has this name"),
                    say("rename_one", "rename one"),
                )
            maps[name] = made if len(findings) == before else None
    return {name: made for name, made in maps.items() if name not in REGISTER_MAPS}


def _map(findings: Findings, raw: dict[str, Any], key: Key) -> RegisterMap | None:
    before = len(findings)
    section = findings.model(MapSection, raw, key)
    if section is not None and section.like is not None:
        return _alike(findings, section, section.like, key)
    if section is not None and section.registers is None:
        findings.add(
            (*key, "registers"),
            None,
            say("it_is_missing", "it is missing"),
            say("add_registers_or_like", "add [[maps.registers]], or like = a map of the drivers"),
        )
    parts = {name: raw[name] for name in ("canary", "watchdog") if isinstance(raw.get(name), dict)}
    canary = findings.model(CanarySection, parts["canary"], (*key, "canary")) if "canary" in parts else None
    watchdog = findings.model(WatchdogSection, parts["watchdog"], (*key, "watchdog")) if "watchdog" in parts else None
    given = raw.get("registers")
    order = (None if section is None else section.word_order) or WordOrder.ABCD
    rows: list[RegisterSection] = []
    registers: list[Register] = []
    for index, one in enumerate(given if isinstance(given, list) else []):
        place = (*key, "registers", index)
        row = findings.model(RegisterSection, one, place) if isinstance(one, dict) else None
        register = None if row is None else _register(findings, row, order, place)
        if row is not None and register is not None:
            rows.append(row)
            registers.append(register)
    if section is None or len(findings) > before:
        return None
    _check_roles(findings, rows, registers, key)
    try:
        made = RegisterMap(
            section.name,
            section.source,
            tuple(registers),
            canary=_canary(canary),
            roles={row.role: row.name for row in rows if row.role is not None},
            readbacks={row.name: row.readback for row in rows if row.readback is not None},
            statuses={row.name: row.status for row in rows if row.status is not None},
            watchdog=_watchdog(watchdog),
            write_function=section.write_function or 16,
            is_positioner=bool(section.is_positioner),
            number=section.number,
        )
        faults = (*_unnamed(made), *map_faults(made))
    except ConfigurationError as error:
        findings.add_error(key, error)
        return None
    for fault in faults:
        findings.add(key, section.name, fault, say("correct_the_map", "correct the map"))
    return made


def _alike(findings: Findings, section: MapSection, like: str, key: Key) -> RegisterMap | None:
    """Return a map of the drivers with what this section changes of it, or None with its faults noted."""
    given, before = section.model_dump(exclude_none=True), len(findings)
    device = REGISTER_MAPS.get(like)
    if device is None:
        findings.add(
            (*key, "like"),
            like,
            say("no_such_map", "the drivers have no such map"),
            say("choose_one_of", "choose one of {known:, }", known=tuple(REGISTER_MAPS)),
        )
    for name in ("registers", "is_positioner", "canary", "watchdog", "number"):
        if name in given:
            findings.add(
                (*key, name),
                given[name],
                say("like_says_it", "{like} says it", like=like),
                say("leave_like_out", "remove it, or leave like out and say all"),
            )
    if device is None:
        return None
    order = section.word_order
    if order is not None and device.capture is not None:
        reason = say(
            "capture_has_order", "{like} has a capture buffer, and that has a word order of its own", like=str(like)
        )
        findings.add(
            (*key, "word_order"), str(order), reason, say("let_device_count", "remove it, and let the device count so")
        )
    made = replace(
        device,
        name=section.name,
        source=f"{section.source}; {device.source}",
        registers=tuple(
            one if order is None or one.words == 1 else replace(one, word_order=order) for one in device.registers
        ),
        golden=(),  # frames of the map that it is like
        write_function=section.write_function or device.write_function,
    )
    for fault in map_faults(made):
        findings.add(key, section.name, fault, say("correct_the_map", "correct the map"))
    return made if len(findings) == before else None


def _register(findings: Findings, row: RegisterSection, order: WordOrder, key: Key) -> Register | None:
    """Return one register in SI units, or None with its faults noted."""
    si = SI_FACTORS.get(row.unit)
    if si is None:
        findings.add(
            (*key, "unit"),
            row.unit,
            say("unit_unknown", "this unit is unknown"),
            say("choose_one_of", "choose one of {known:, }", known=tuple(SI_FACTORS)),
        )
        return None
    is_one_word = row.kind in (Kind.U16, Kind.I16)
    if row.word_order is not None and is_one_word:
        reason = say("one_register", "{name} is {kind}, one register, which has no order", name=row.name, kind=row.kind)
        findings.add((*key, "word_order"), str(row.word_order), reason, say("remove_it", "remove it"))
        return None
    if row.raw_range is not None and not row.raw_range[0] < row.raw_range[1]:
        findings.add(
            (*key, "raw_range"),
            list(row.raw_range),
            say("must_rise", "it must rise"),
            say("lower_raw_first", "give the lower raw value first"),
        )
        return None
    unit, factor = si
    try:
        register = Register(
            row.name,
            row.address,
            row.kind,
            row.table,
            unit,
            row.scale * factor,
            row.offset * factor,
            WordOrder.ABCD if is_one_word else (row.word_order or order),
            row.writable,
            row.raw_range,
            row.meaning,
        )
        outside = [] if row.raw_range is None else [one for one in row.raw_range if not _fits(row.kind, one)]
    except ConfigurationError as error:
        findings.add_error(key, error)
        return None
    for raw in outside:
        span = Register(row.name, 0, row.kind).span
        findings.add(
            (*key, "raw_range"),
            raw,
            say(
                "kind_holds",
                "{kind} holds {least:.12g} to {greatest:.12g}",
                kind=row.kind,
                least=span.least,
                greatest=span.greatest,
            ),
            say("stay_inside", "stay inside"),
        )
    return None if outside else register


def _fits(kind: Kind, raw: float) -> bool:
    span = Register("raw", 0, kind).span
    return math.isfinite(raw) and span.least <= raw <= span.greatest


def _check_roles(findings: Findings, rows: Sequence[RegisterSection], registers: Sequence[Register], key: Key) -> None:
    """Note roles that two registers have, or that a register cannot play."""
    names = Counter(row.role for row in rows if row.role is not None)
    units = {register.name: register.unit for register in registers}
    for index, (row, register) in enumerate(zip(rows, registers, strict=True)):
        place = (*key, "registers", index)
        if row.role is not None:
            if names[row.role] > 1:
                findings.add(
                    (*place, "role"),
                    str(row.role),
                    say("role_twice", "two registers have this role"),
                    say("leave_to_one", "leave it to one of them"),
                )
            quantities = ("m", *_SIGNALS) if row.role is Role.POSITION else ("Pa", *_SIGNALS)
            if register.unit not in quantities:
                reason = say(
                    "unit_of_role",
                    "{name} is in {unit}, a {role} is in {units:, }",
                    name=row.name,
                    unit=register.unit,
                    role=row.role,
                    units=tuple(quantities),
                )
                findings.add((*place, "unit"), row.unit, reason, say("correct_unit_or_role", "correct unit or role"))
        if row.role is Role.COMMAND and not row.writable:
            reason = say("command_not_writable", "a command is written, and this register is not writable")
            findings.add(
                (*place, "writable"), row.writable, reason, say("say_writable", "say writable = true, or move the role")
            )
        if row.readback is not None and units.get(row.readback, register.unit) != register.unit:
            reason = say(
                "units_differ",
                "{readback} is in {unit} and {name} in {other}",
                readback=row.readback,
                unit=units[row.readback],
                name=row.name,
                other=register.unit,
            )
            findings.add(
                (*place, "readback"), row.readback, reason, say("name_same_unit", "name a register in the same unit")
            )
        if row.readback == row.name:
            findings.add(
                (*place, "readback"),
                row.readback,
                say("register_itself", "it is the register itself"),
                say("name_another", "name another, or remove it"),
            )


def _unnamed(made: RegisterMap) -> Iterator[str]:
    """What the map's parts name and no register is called."""
    watchdog = made.watchdog
    if watchdog is None:
        return
    for name in (watchdog.timeout, watchdog.heartbeat, watchdog.safe_value, *filter(None, (watchdog.run,))):
        if not made.register(name).writable:
            yield say(
                "watchdog_not_writable", "{name} belongs to the watchdog, is written, and is not writable", name=name
            )
    made.register(watchdog.state)
    for name, unit in ((watchdog.timeout, "s"), (watchdog.safe_value, "Pa")):
        if made.register(name).unit != unit:
            is_in = made.register(name).unit
            yield say(
                "watchdog_unit",
                "{name} of the watchdog is in {is_in}, it must be in {unit}",
                name=name,
                is_in=is_in,
                unit=unit,
            )


def _canary(section: CanarySection | None) -> Canary | None:
    return None if section is None else Canary(section.register_name, section.expected, section.differs)


def _watchdog(section: WatchdogSection | None) -> Watchdog | None:
    return None if section is None else Watchdog(**section.model_dump())


def without_wrong(maps: Mapping[str, RegisterMap | None]) -> dict[str, RegisterMap]:
    """Return the maps that are right, by name."""
    return {name: one for name, one in maps.items() if one is not None}
