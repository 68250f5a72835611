"""Valves of a CSV file as ``[[valves]]`` of a plant file: a row a valve, a column a key, every fault by row and column.

A column is called like its key in plant.toml with its table, ``actuator.travel``; the table may be left out. A value is
written as there, with a unit in the cell or in the header, ``travel (in)``; a range is ``3 to 15 psi``. What the cells
hold is judged with the whole plant file and by nothing else, so an import accepts what ``breakaway check`` accepts.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import tomlkit

from drivers.addresses import MotionLimits, Point, Sampling, WatchdogChoice
from drivers.permissive_rules import PermissiveRules
from service.config.errors import Fault
from service.config.plant import Identity
from service.config.settings import faults_of
from service.config.units import as_value, hints_of, in_si, own_names, types_in
from service.config.valves import ValveSection
from service.model.health_limits import HealthLimits
from service.words.spelling import nearest
from valve.errors import ConfigurationError
from valve.messages import Message, changed, message_of, say
from valve.nameplate import Actuator, Signal

# The order counts: a column without its table is the first that has such a key.
_TABLES: Final[dict[str, Any]] = {
    "": ValveSection,
    "actuator": Actuator,
    "signal": Signal,
    "limits": MotionLimits,
    "command": Point,
    "acquisition": Sampling,
    "watchdog": WatchdogChoice,
    "permissives": PermissiveRules,
    "health": HealthLimits,
    "position": Point,
    "pressure": Point,
}
_NEVER_ALIKE: Final = (
    "tag",
    "safe_value_pa",
    "safe_position_m",
    "safe_position_tolerance_m",
    *(one.name for one in fields(Identity)),
)
_CONTACTS: Final = ("manual", "interlock", "supply")  # of permissives: places of their own, which no column names
_MOST_BYTES: Final = 2**24
_HEADER: Final = re.compile(r"(.*?)\s*(?:\(([^()]*)\)|\[([^\[\]]*)\])?")
_YES_NO: Final = {"true": True, "yes": True, "false": False, "no": False}


class _Key(NamedTuple):
    """A key of a valve: its table, "" for the valve's own, and its name there."""

    table: str
    name: str

    def __str__(self) -> str:
        return f"{self.table}.{self.name}" if self.table else self.name


@dataclass(frozen=True, slots=True)
class _Column:
    """A column: its header, the key that it gives, and the unit that the header names, "" without."""

    header: str
    key: _Key
    unit: str


@dataclass(frozen=True, slots=True)
class _Row:
    """A valve's row, counted as a spreadsheet does, and the cells that say something, by their columns."""

    number: int
    cells: Mapping[_Column, str]


@dataclass(frozen=True, slots=True)
class ImportedValves:
    """The plant file's text with the new valves, and their tags; or what is wrong, and then the text is of no use."""

    text: str
    tags: tuple[str, ...]
    faults: tuple[Fault, ...]


def import_valves(data: bytes, source: str, plant_file: Path, like: str | None = None) -> ImportedValves:
    """Return a plant file with the valves of a CSV file behind its own; nothing is written.

    What a row does not say is as in the valve ``like``, but never the tag, the safe value, what people know it by, or
    where it is read and driven.
    Raises ConfigurationError where one of the two cannot be read at all, or has no such valve.
    """
    try:
        text = plant_file.read_bytes().decode("utf-8")
        plant = tomllib.loads(text)
    except OSError as error:
        raise ConfigurationError(
            say(
                "no_plant_file",
                "{file}: it cannot be read ({reason}): write one by `breakaway init` first",
                file=str(plant_file),
                reason=str(error.strerror),
            )
        ) from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(
            say(
                "file_no_toml",
                "{file}: it is no valid TOML: {why}: correct it there",
                file=str(plant_file),
                why=message_of(error),
            )
        ) from None
    present = plant.get("valves")
    present = present if isinstance(present, list) else []
    columns, rows, faults = _read(data, source)
    if faults:
        return ImportedValves(text, (), tuple(faults))
    valves = [_valve(row, _base(present, like, plant_file.name)) for row in rows]
    added = tomlkit.dumps({"valves": valves})
    whole = f"{text.rstrip()}\n\n{added}".lstrip()
    _, found = faults_of(plant_file, whole)
    told = _by_cells(found, source, columns, rows, len(present))
    return ImportedValves(whole, tuple(str(valve.get("tag", "")) for valve in valves), tuple(told))


def _read(data: bytes, source: str) -> tuple[list[_Column], list[_Row], list[Fault]]:
    """Return columns and rows of a CSV file, with what is wrong with its shape."""
    if len(data) > _MOST_BYTES:
        raise ConfigurationError(
            say(
                "csv_too_large",
                "{source}: it has {count} bytes, at most {most} are read: cut it in parts",
                source=str(source),
                count=len(data),
                most=_MOST_BYTES,
            )
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")  # what a spreadsheet on Windows calls CSV
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    try:
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True))
    except csv.Error as error:
        raise ConfigurationError(
            say(
                "no_csv",
                "{source}: it is no CSV ({why}): save it as CSV, UTF-8",
                source=str(source),
                why=message_of(error),
            )
        ) from None
    faults: list[Fault] = []
    columns = list(_columns(lines[0] if lines else [], source, faults))
    if not faults and "tag" not in [str(column.key) for column in columns if column is not None]:
        faults.append(
            Fault(
                source,
                "row 1",
                None,
                say("no_tag_column", "no column is called tag"),
                say("name_the_columns", "begin with a line that names the columns"),
            )
        )
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        cells = {column: cell.strip() for column, cell in zip(columns, line, strict=False) if column is not None}
        cells = {column: cell for column, cell in cells.items() if cell}
        if separator != ",":
            cells = {column: _decimal_point(column, cell) for column, cell in cells.items()}
        for place, cell in enumerate(line[len(columns) :], start=len(columns) + 1):
            if cell.strip():
                reason = say("columns_named", "the first row names {n} columns", n=len(columns))
                remedy = say("name_this_column", "name this one, or put a cell with a separator in it in quotes")
                faults.append(Fault(source, f"row {number}, column {place}", json.dumps(cell), reason, remedy))
        if cells:
            rows.append(_Row(number, cells))
    if not faults and not rows:
        faults.append(
            Fault(
                source,
                "row 2",
                None,
                say("no_valve_follows", "no valve follows the names of the columns"),
                say("give_row_a_valve", "give a row a valve"),
            )
        )
    return [column for column in columns if column is not None], rows, faults


def _columns(headers: Sequence[str], source: str, faults: list[Fault]) -> Iterator[_Column | None]:
    """Yield what each column gives, None for one that is empty or wrong, which is noted."""
    known, seen = _known_keys(), dict[_Key, str]()
    for place, header in enumerate(headers, start=1):
        found = _HEADER.fullmatch(header.strip())
        name = re.sub(r"\s+", "_", found[1].strip().casefold()) if found is not None else ""
        key = known.get(name)
        if not header.strip():
            yield None
        elif found is None or key is None:
            close = nearest(name, known)
            remedy = (
                say("call_it", "call it {close}", close=close)
                if close
                else say("call_like_key", "call it like a key of [[valves]] in docs/plant.md, or remove it")
            )
            faults.append(
                Fault(
                    source,
                    f"row 1, column {place}",
                    json.dumps(header),
                    say("no_key_of_name", "no key has this name"),
                    remedy,
                )
            )
            yield None
        elif key in seen:
            reason = say("column_gives_twice", "column {column} gives {key} already", column=seen[key], key=str(key))
            faults.append(
                Fault(source, f"row 1, column {place}", json.dumps(header), reason, say("remove_one", "remove one"))
            )
            yield None
        else:
            seen[key] = header.strip()
            yield _Column(header.strip(), key, found[2] or found[3] or "")


@lru_cache(maxsize=1)
def _known_keys() -> dict[str, _Key]:
    """Return every key that a column can give, by the names that it may have there."""
    keys = [
        _Key(table, name)
        for table, kind in _TABLES.items()
        for name in (*hints_of(kind), *own_names(kind))
        if not _is_table(kind, name)
    ]
    short: dict[str, _Key] = {}
    for key in keys:
        short.setdefault(key.name, key)
    return short | {str(key): key for key in keys}


def _is_table(kind: Any, name: str) -> bool:
    hint = hints_of(kind).get(name)
    return hint is not None and any(hints_of(one) or str(one).startswith("dict") for one in types_in(hint))


def _types(key: _Key) -> list[Any]:
    """Return what a key may be: of a name without a unit, what its SI keys may be."""
    kind = _TABLES[key.table]
    names = own_names(kind).get(key.name, (key.name,))
    return [one for name in names for one in types_in(hints_of(kind)[name])]


def _is_number(key: _Key) -> bool:
    return any(one in (int, float) for one in _types(key))


def _decimal_point(column: _Column, cell: str) -> str:
    """Return a cell of a file whose separator leaves the comma to the numbers."""
    return re.sub(r"(?<=\d),(?=\d)", ".", cell) if _is_number(column.key) else cell


def _value(column: _Column, cell: str) -> Any:
    """Return a cell as plant.toml would have it; what cannot be is left as a text, which the check then refuses."""
    types = _types(column.key)
    if bool in types:
        return _YES_NO.get(cell.casefold(), cell)
    if not _is_number(column.key):
        return cell
    return as_value(cell, column.unit)


def _base(valves: Sequence[Any], like: str | None, file: str) -> dict[str, Any]:
    """Return what a row leaves open: the valve ``like`` in SI keys, without what is each valve's own.

    No place is taken over at which another valve is read or driven: its device_id, and the bus of a gauge.
    """
    if like is None:
        return {}
    found = next((one for one in valves if isinstance(one, dict) and one.get("tag") == like), None)
    if found is None:
        raise ConfigurationError(
            say(
                "no_valve_like",
                "{file}: no valve has the tag {like}: give --like one that is there",
                file=str(file),
                like=like,
            )
        )
    base = in_si(ValveSection, found).values
    for name, value in found.items():
        if name in _TABLES and isinstance(value, dict):
            base[name] = in_si(_TABLES[name], value).values
    contacts = [name for name in _CONTACTS if name in (base.get("permissives") or ())]
    if contacts:
        raise ConfigurationError(
            say(
                "contacts_of_one_valve",
                "{file}: {like} has permissives.{contacts}, which shows that valve alone: give --like one without it",
                file=str(file),
                like=like,
                contacts=contacts[0],
            )
        )
    for point in (base[name] for name in ("command", "position", "pressure") if isinstance(base.get(name), dict)):
        point.pop("device_id" if "map" in point else "bus", None)
    return {name: value for name, value in base.items() if name not in _NEVER_ALIKE}


def _valve(row: _Row, base: dict[str, Any]) -> dict[str, Any]:
    """Return a row as a table of the plant file; ``base`` is changed."""
    own: dict[str, Any] = {}
    for column, cell in row.cells.items():
        kind, key, value = _TABLES[column.key.table], column.key, _value(column, cell)
        table = base.setdefault(key.table, {}) if key.table else base
        for name in in_si(kind, {key.name: value}).values:
            table.pop(name, None)  # what the valve alike has in SI
        table.pop(key.name, None)
        (table if key.table else own)[key.name] = value
    plain = {name: value for name, value in base.items() if not isinstance(value, dict)}
    return {**own, **plain, **{name: value for name, value in base.items() if isinstance(value, dict)}}


def _by_cells(
    found: Sequence[Fault], source: str, columns: Sequence[_Column], rows: Sequence[_Row], first: int
) -> list[Fault]:
    """Return faults of a plant file by row and column of the CSV file that its last valves are from."""
    by_key = {str(column.key): column for column in columns}
    for column in columns:  # what is missing is told by the SI key
        for name in own_names(_TABLES[column.key.table]).get(column.key.name, ()):
            by_key.setdefault(str(_Key(column.key.table, name)), column)
    told: dict[Fault, list[int]] = {}
    in_cells: set[Fault] = set()
    for fault in found:
        row = _row_of(fault, rows, first)
        if row is None:
            told.setdefault(fault, [])
            continue
        path = ".".join(part for part in fault.place[2:] if isinstance(part, str))
        given = by_key.get(path) or by_key.get(fault.named)
        if given is None:
            told.setdefault(replace(fault, file=source, key=path or "the valve", place=()), []).append(row.number)
        else:
            cell = row.cells.get(given)
            shown = None if cell is None else json.dumps(cell, ensure_ascii=False)
            key = f"row {row.number}, column {given.header}"
            in_cell = replace(fault, file=source, key=key, value=shown, place=())
            told.setdefault(in_cell, [row.number])
            in_cells.add(in_cell)
    in_order = sorted(told.items(), key=lambda one: 0 if _is_of_all(one[1], rows) else one[1][0])
    return [
        _as_cell(fault if fault in in_cells else replace(fault, key=_in_rows(fault.key, rows_of, rows)))
        for fault, rows_of in in_order
    ]


def _row_of(fault: Fault, rows: Sequence[_Row], first: int) -> _Row | None:
    """Return the row of the valve that a fault is about, None where it is about none of them."""
    match fault.place:
        case ("valves", int(place), *_) if place >= first:
            return rows[place - first]
    return None


def _is_of_all(numbers: Sequence[int], rows: Sequence[_Row]) -> bool:
    """Whether something is not of some rows alone: of none, or of each of several."""
    return not numbers or len(numbers) == len(rows) > 1


def _as_cell(fault: Fault) -> Fault:
    """Return a fault whose remedy is for a cell, which needs no quotes and no brackets."""
    return replace(fault, remedy=changed(fault.remedy, _for_cell))


def _for_cell(text: str) -> str:
    if not isinstance(text, Message):
        return text
    if text.code == "give_list":
        return say("give_both_ends", "give both ends such as 3 to 15 psi")
    if text.code != "write_with_unit":
        return text
    units, unit = text.values["units"], text.values["unit"]
    return say("write_cell_with_unit", "write it with a unit such as {units}: 6 {unit}", units=units, unit=unit)


def _in_rows(key: str, numbers: Sequence[int], rows: Sequence[_Row]) -> str:
    """Return where something is that has no column: the row, or all of them."""
    if not numbers:
        return key
    if _is_of_all(numbers, rows):
        return f"all {len(rows)} rows, {key}"
    return f"row{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}, {key}"


__all__ = ["ImportedValves", "import_valves"]
