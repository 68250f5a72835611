"""Reads a loop that has no stem position: controller output, process value and, where there is one, the set point."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.own_files.cells import BadCellError, has_decimal_comma, is_gap_text, is_number, is_stamp, numbers, stamps
from service.own_files.names import Quantity, is_of_another_place, quantities, unit_of, without_unit
from service.own_files.table import Table, find_table
from service.own_files.understood import Understood, UnderstoodColumn
from valve.errors import RecordingError
from valve.messages import say
from valve.recording import FloatArray
from valve.recording_files import file_content

OUTPUT: Final = "controller_output"
VALUE: Final = "process_value"
SETPOINT: Final = "set_point"
LOOP_COLUMNS: Final = (OUTPUT, VALUE, SETPOINT)
_TIME: Final = "time_s"
_NAMES: Final = (_TIME, *LOOP_COLUMNS)
# The last word of a tag. "MV" and "CV" are left out: to some they are the output, to others the value.
_WORDS: Final = {
    **dict.fromkeys(("op", "out", "co", "output", "stellgrosse", "stellgroesse", "stellwert"), OUTPUT),
    **dict.fromkeys(("pv", "istwert", "process value", "messwert"), VALUE),
    **dict.fromkeys(("sp", "setpoint", "set point", "sollwert"), SETPOINT),
}
_MOST_SHOWN: Final = 12
_AS_IT_IS: Final = say("as_it_is", "as it is")


@dataclass(frozen=True, slots=True, eq=False)
class LoopReading:
    """Columns of shape (n,), NaN for a gap: s, and output, value and set point in the file's own units, "" unknown."""

    time_s: FloatArray
    output: FloatArray
    value: FloatArray
    setpoint: FloatArray | None
    output_unit: str
    value_unit: str
    understood: Understood


def find_loop(path: Path, mapping: Mapping[str, str]) -> LoopReading | None:
    """Return the loop of a file that nobody called one; None where a stem is in it, or output or value is not surely.

    Raises RecordingError as ``read_loop``.
    """
    table = _table(path)
    if table is None or _has_position(table):
        return None
    places = _places(table, {name: wanted for name, wanted in mapping.items() if name == _TIME})
    return _read(path, table, places) if OUTPUT in places and VALUE in places else None


def read_loop(path: Path, mapping: Mapping[str, str]) -> LoopReading:
    """Return the loop of a file, by the mapping and what headers say of the rest, whatever else is in the file.

    Raises RecordingError where output, value or time is not there, a cell is no number, or the time has no unit.
    """
    table = _table(path)
    if table is None:
        raise RecordingError(
            say(
                "no_table_of_numbers",
                "{path}: there is no table of numbers below a header line: give one",
                path=str(path),
            )
        )
    return _read(path, table, _places(table, mapping))


def _table(path: Path) -> Table | None:
    data = file_content(path)
    table = find_table(data, str(path)) if data.strip() else None
    return table if table is not None and table.rows > 0 else None


def _read(path: Path, table: Table, places: Mapping[str, tuple[int, str]]) -> LoopReading:
    """Return the columns at these places."""
    missing = [name for name in (OUTPUT, VALUE, _TIME) if name not in places]
    if missing:
        example = ",".join(f"{name}=HEADER" for name in missing)
        raise RecordingError(
            say(
                "no_column_for_loop",
                "{path}: no column is surely {missing: and none }, there are {columns}: say which column is what, for "
                'example --map "{example}"',
                path=str(path),
                missing=tuple(missing),
                columns=_listed(table),
                example=example,
            )
        )
    comma = _decimal_comma(table, places)
    columns: dict[str, FloatArray] = {}
    said, units = [], {}
    for name in _NAMES:
        if name not in places:
            continue
        at, unit = places[name]
        try:
            columns[name], units[name], how = (
                _time(table, at, unit) if name == _TIME else _values(table, at, unit, comma)
            )
        except BadCellError as bad:
            raise RecordingError(
                say(
                    "cell_of_loop",
                    "{path}: row {row} (line {line} of the file), column {header}: {text} is not a number: {hint}",
                    path=str(path),
                    row=bad.row + 1,
                    line=table.line_of(bad.row),
                    header=repr(table.headers[at]),
                    text=repr(str(bad)[:40]),
                    hint=bad.hint or say("give_number_or_none", "give a number, or nothing"),
                )
            ) from None
        said.append(UnderstoodColumn(table.headers[at], name, units[name], how, int(np.isnan(columns[name]).sum())))
    used = {at for at, _ in places.values()}
    not_used = tuple(header for at, header in enumerate(table.headers) if at not in used and header)
    return LoopReading(
        columns[_TIME],
        columns[OUTPUT],
        columns[VALUE],
        columns.get(SETPOINT),
        units[OUTPUT],
        units[VALUE],
        Understood(path.name, table.kind, table.rows, tuple(said), not_used),
    )


def _places(table: Table, mapping: Mapping[str, str]) -> dict[str, tuple[int, str]]:
    """Return column and unit of each name that is found, the mapping's first."""
    places = {name: _mapped(table, name, wanted) for name, wanted in mapping.items() if wanted and name in _NAMES}
    for name in _NAMES:
        if name in mapping:
            continue
        taken = {at for at, _ in places.values()}
        fits = [at for at, header in enumerate(table.headers) if at not in taken and name in _meanings(header)]
        if len(fits) > 1:
            raise RecordingError(
                say(
                    "name_fits_columns",
                    '{source}: {name} fits {count} columns, {columns}: say which, for example --map "{name}={first}"',
                    source=table.source,
                    name=name,
                    count=len(fits),
                    columns=_listed(table, fits),
                    first=table.headers[fits[0]],
                )
            )
        if fits:
            places[name] = (fits[0], "")
    return places


def _mapped(table: Table, name: str, wanted: str) -> tuple[int, str]:
    bare, unit = without_unit(wanted)
    for text, own in ((wanted, ""), (bare, unit)):
        at = [number for number, header in enumerate(table.headers) if header.strip() == text.strip()]
        if len(at) == 1:
            return at[0], own
    raise RecordingError(
        say(
            "mapped_header_missing",
            "{source}: --map gives {name} the header {header}, the file has {columns}: give one",
            source=table.source,
            name=name,
            header=repr(wanted[:60]),
            columns=_listed(table),
        )
    )


def _meanings(header: str) -> tuple[str, ...]:
    """Return what a header means: FIC-101.PV, LIC7_OP, "Process value [%]", Timestamp."""
    name = " ".join(re.findall(r"[^\W_]+", without_unit(header)[0].casefold()))
    if name in (*(one.replace("_", " ") for one in LOOP_COLUMNS),):
        return (name.replace(" ", "_"),)
    tail = re.search(r"(?:^|[ \d])(process value|set point|[^\W\d_]+)$", name)
    if tail is not None and tail[1] in _WORDS:
        return (_WORDS[tail[1]],)
    return (_TIME,) if quantities(header) == (Quantity.TIME,) else ()


def _has_position(table: Table) -> bool:
    return any(
        Quantity.POSITION in quantities(header) and not is_of_another_place(header) and not _meanings(header)
        for header in table.headers
    )


def _listed(table: Table, columns: list[int] | None = None) -> str:
    shown = [repr(table.headers[at]) for at in (range(len(table.headers)) if columns is None else columns)]
    if len(shown) <= _MOST_SHOWN:
        return say("columns_listed", "{columns:, }", columns=tuple(shown))
    return say(
        "columns_and_more",
        "{columns:, } and {more} more",
        columns=tuple(shown[:_MOST_SHOWN]),
        more=len(shown) - _MOST_SHOWN,
    )


def _decimal_comma(table: Table, places: Mapping[str, tuple[int, str]]) -> bool | None:
    told = [
        comma
        for name, (at, _) in places.items()
        if name != _TIME and (comma := has_decimal_comma(table.columns[at])) is not None
    ]
    return None if not told else any(told)


def _time(table: Table, at: int, unit_text: str) -> tuple[FloatArray, str, str]:
    """Return seconds, the unit's name and what was done."""
    header, cells = table.headers[at], table.columns[at]
    seen = (str(cell).strip() for cell in cells.slice(0, 50).to_pylist())
    first = next((cell for cell in seen if cell and not is_gap_text(cell)), "")
    if is_stamp(first) and not is_number(first):
        found = stamps(cells, table.source, header)
        return found.time_s, found.words, say("seconds_from_first_row", "seconds from the first row")
    text = unit_text or without_unit(header)[1] or table.units[at] or ("s" if header.strip() == _TIME else "")
    unit = unit_of(text) if text else None
    if unit is None or unit.dimension != "time":
        raise RecordingError(
            say(
                "time_without_unit",
                '{source}: the time in column {column} has no unit: give it, for example --map "{name}={header} [s]"',
                source=table.source,
                column=repr(header),
                name=_TIME,
                header=header,
            )
        )
    return (
        numbers(cells).values * unit.factor,
        unit.text,
        _AS_IT_IS if unit.factor == 1.0 else say("converted", "converted"),
    )


def _values(table: Table, at: int, unit_text: str, comma: bool | None) -> tuple[FloatArray, str, str]:
    read: Any = numbers(table.columns[at], comma_elsewhere=comma)
    unit = unit_text or _bracketed(table.headers[at]) or table.units[at].strip("[](){} ")
    return read.values, unit, say("as_it_is_comma", "as it is, decimal comma") if read.decimal_comma else _AS_IT_IS


def _bracketed(header: str) -> str:
    """Return the unit of a header; what stands in brackets counts as one, known or not: m3/h."""
    found = re.search(r"[\[(]([^\[\]()]{1,12})[\])]\s*$", header)
    return found[1].strip() if found is not None else without_unit(header)[1]
