"""The table in a file: text, xlsx or Parquet becomes headers and columns of cells."""

from __future__ import annotations

import csv
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time
from statistics import mode
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from service.own_files.cells import is_gap_text, is_number, is_stamp
from service.own_files.content import ZIP, bytes_of_rows, plain, require_size, text_of
from service.own_files.names import is_unit, number_and_unit, quantities, unit_of, without_unit
from valve.errors import RecordingError
from valve.recording_csv import too_many_rows
from valve.recording_parquet import whole_table

SECOND_TABLE: Final = "begins a second table"
_MOST_ROWS: Final = 20_000_000
_HEAD_ROWS: Final = 2000  # a header stands within them
_RUN_ROWS: Final = 50
_TABLE_ROWS: Final = 20
_HEADER_ROWS: Final = 4  # names, units, a comment
_LOOKED_AT: Final = 50  # cells of a column
_SPACES: Final = "  "  # two spaces or more between columns
_SEPARATORS: Final = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", _SPACES: "spaces", " ": "spaces"}


@dataclass(frozen=True, slots=True)
class Layout:
    """Where a table stands, rows counted from 0: its names, its units (None without), its first row; its width."""

    header: int
    units: int | None
    first: int
    width: int
    matches: int  # headers that mean something
    run: int  # rows like the first one that follow it
    other: int | None = None  # the header of another table among the rows that were looked at


@dataclass(frozen=True, slots=True)
class Table:
    """Headers, the unit of each from a row of units ("" without), and the cells of each column as text."""

    source: str
    kind: str  # what the file is, in words
    headers: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[pa.Array, ...]
    line_of: Callable[[int], int]  # line of the file in which row 0, 1, ... stands
    left_out_lines: int = 0  # after the table, without numbers

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.columns[0])


def find_table(data: bytes, source: str, most_rows: int | None = None) -> Table | None:
    """Return the one table of a file, None where there is none.

    With ``most_rows`` a file of more rows, or of more bytes than they have, is refused before it is unpacked.
    Raises RecordingError where the file cannot be unpacked or is no text, or where it holds two tables.
    """
    most_rows = _MOST_ROWS if most_rows is None else most_rows
    data, prefix = plain(data, bytes_of_rows(most_rows), source)
    table = _of_kind(data, source, prefix, most_rows)
    return None if table is None else _without_cell_units(table)


def _of_kind(data: bytes, source: str, prefix: str, most_rows: int) -> Table | None:
    if data.startswith(b"PAR1"):
        return _of_parquet(data, source, prefix, most_rows)
    if data.startswith(ZIP):
        return _of_workbook(data, source, prefix, most_rows)
    if data.startswith(b"\xd0\xcf\x11\xe0"):
        raise RecordingError(f"{source}: it is a workbook of the old kind (xls): save it as xlsx or as CSV")
    return _of_text(data, source, prefix, most_rows)


def _without_cell_units(table: Table) -> Table:
    """Return a table whose cells had their units beside the numbers, ``12.5 psi``, with the units below the headers.

    Where header and cells name different units the cells stay as they are, which the reader refuses.
    """
    columns, units = list(table.columns), list(table.units)
    for at, column in enumerate(columns):
        seen = [cell for one in column.slice(0, _LOOKED_AT).to_pylist() if (cell := str(one).strip())]
        split = [number_and_unit(cell) for cell in seen if not is_gap_text(cell)]
        own = {one[1] for one in split if one is not None}
        if len(own) != 1 or None in split:
            continue
        (unit,) = own
        stated = unit_of(without_unit(table.headers[at])[1]) or unit_of(units[at])
        if stated is None or stated == unit_of(unit) or unit == stated.text:
            columns[at] = pc.replace_substring_regex(pc.utf8_trim_whitespace(column), rf"\s*{re.escape(unit)}$", "")
            units[at] = unit
    return replace(table, columns=tuple(columns), units=tuple(units))


# ---------------------------------------------------------------- text


def _of_text(data: bytes, source: str, prefix: str, most_rows: int) -> Table | None:
    text, encoding = text_of(data, source)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if (lines := text.count("\n")) > most_rows + _HEAD_ROWS:
        raise RecordingError(too_many_rows(source, lines, most_rows))
    head = text[: 400 * _HEAD_ROWS].split("\n", _HEAD_ROWS)[:_HEAD_ROWS]
    found: list[tuple[tuple[int, int, int], str, Layout]] = []
    for order, separator in enumerate(_SEPARATORS):
        layout = find_layout([_cells(line, separator) for line in head])
        if layout is not None:
            found.append(((layout.matches, min(layout.run, _RUN_ROWS), -order), separator, layout))
    if not found:
        return None
    _, separator, layout = max(found, key=lambda one: one[0])
    _refuse_another(layout, source)
    headers = _padded(_cells(head[layout.header], separator), layout.width)
    units = [""] * layout.width
    if layout.units is not None:
        units = _padded(_cells(head[layout.units], separator), layout.width)
    body = text.split("\n", layout.first)[-1]
    columns, after = _columns_of_text(body, separator, layout, source)
    return Table(
        source=source,
        kind=f"{prefix}text, {encoding}, {_SEPARATORS[separator]} between columns, header in line {layout.header + 1}",
        headers=tuple(headers),
        units=tuple(units),
        columns=tuple(columns),
        line_of=lambda row: _line_of(body, separator, layout, row),
        left_out_lines=after,
    )


def _cells(line: str, separator: str) -> list[str]:
    line = _tabbed(line, separator)
    if not line.strip():
        return []
    try:
        cells = next(csv.reader([line], delimiter="\t" if separator in (_SPACES, " ") else separator), [])
    except csv.Error:
        cells = line.split(separator)
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _tabbed(text: str, separator: str) -> str:
    if separator not in (_SPACES, " "):
        return text
    least = len(separator)
    return re.sub(rf"(?m)(?<=\S) {{{least},}}(?=\S)", "\t", re.sub(r"(?m)^ +| +$", "", text))


def _padded(cells: Sequence[str], width: int) -> list[str]:
    cells = list(cells[:width])
    if cells:
        cells[0] = cells[0].lstrip("#").strip()
    return cells + [""] * (width - len(cells))


def find_layout(rows: Sequence[Sequence[str]]) -> Layout | None:
    """Return where the longest table of these rows begins, None without rows of numbers below a header."""
    found: list[Layout] = []
    row = 0
    while row < len(rows):
        count, past = _run(rows, row)
        if count and (layout := _headed(rows, row, count, past)) is not None:
            found.append(layout)
        row = max(past, row + 1)
    if not found:
        return None
    best = max(found, key=lambda one: one.run)
    # a few numbers on the channels are no table, rows of the same quantities are
    others = [one for one in found if one is not best and (one.run >= _TABLE_ROWS or one.matches > 1 < one.run)]
    return replace(best, other=others[0].header if others else None)


def _run(rows: Sequence[Sequence[str]], first: int) -> tuple[int, int]:
    """Return how many rows from ``first`` on are rows of one table, and where they end; empty lines do not count."""
    width, count, past = 0, 0, first
    for row in range(first, len(rows)):
        cells = rows[row]
        if not cells and count:
            continue
        if not _holds_values(cells) or (width and abs(len(cells) - width) > max(1, width - 2)):
            break
        width, count, past = max(width, len(cells)), count + 1, row + 1
    return count, past


def _holds_values(cells: Sequence[str]) -> bool:
    values = sum(is_number(cell) or is_stamp(cell) for cell in cells)
    others = sum(bool(cell) and not is_gap_text(cell) for cell in cells) - values
    if values < 2 and others:  # a stamp beside "12.5 psi", or units in every cell
        measured = sum(number_and_unit(cell) is not None for cell in cells)
        if values or measured == others:
            values, others = values + measured, others - measured
    return len(cells) > 1 and values > 0 and (values > 1 or others == 0)


def _headed(rows: Sequence[Sequence[str]], first: int, run: int, past: int) -> Layout | None:
    width = mode(len(cells) for cells in rows[first:past] if cells)
    above: list[int] = []
    row = first - 1
    while row >= 0 and len(above) < _HEADER_ROWS:
        cells = rows[row]
        if cells and (len(cells) < 2 or _holds_values(cells) or width - len(cells) > max(1, width // 2)):
            break
        if cells:
            above.append(row)
        row -= 1
    units = next((row for row in above if _is_units(rows[row])), None)
    named = [row for row in above if row != units]
    if not named:
        return None
    # the topmost of those whose names mean most
    header = max(named, key=lambda row: (_matches(rows[row]), -row))
    width = max(width, len(rows[header]))
    return Layout(header, units, first, width, _matches(rows[header]), run)


def _is_units(cells: Sequence[str]) -> bool:
    given = [cell.strip("[](){} ") for cell in cells if cell.strip("[](){}- ")]
    return bool(given) and 2 * sum(is_unit(cell) for cell in given) > len(given)


def _matches(cells: Sequence[str]) -> int:
    return sum(bool(quantities(cell)) for cell in cells)


def _columns_of_text(body: str, separator: str, layout: Layout, source: str) -> tuple[list[pa.Array], int]:
    """Return the cells of each column, and how many lines after the table hold no numbers."""
    delimiter = "\t" if separator in (_SPACES, " ") else separator
    text = _tabbed(body, separator)
    names = [str(number) for number in range(layout.width)]
    odd: list[str] = []

    def set_aside(row: Any) -> str:
        odd.append(row.text)
        return "skip"

    try:
        table = pa.csv.read_csv(
            io.BytesIO(text.encode("utf-8", "surrogatepass")),
            read_options=pa.csv.ReadOptions(column_names=names, use_threads=False, block_size=2**26),
            parse_options=pa.csv.ParseOptions(delimiter=delimiter, invalid_row_handler=set_aside),
            convert_options=pa.csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise RecordingError(f"{source}: its rows cannot be read as a table: {error}") from None
    rows = [cells for one in odd if (cells := _cells(one, delimiter))]
    kept = [cells for cells in rows if _holds_values(cells)]
    if kept and table.num_rows == 0 and all(one.rstrip().endswith(delimiter) for one in odd if one.strip()):
        without_last = re.sub(rf"(?m){re.escape(delimiter)}[ \r]*$", "", text)
        return _columns_of_text(without_last, delimiter, layout, source)
    if kept:
        _refuse_odd_rows(text, delimiter, layout, source)
    return [table[name].combine_chunks() for name in names], len(rows)


def _columns(arrays: Sequence[Any]) -> list[pa.Array]:
    return [array.combine_chunks() if isinstance(array, pa.ChunkedArray) else array for array in arrays]


def _refuse_another(layout: Layout, source: str) -> None:
    if layout.other is not None:
        line = max(layout.header, layout.other) + 1
        raise RecordingError(f"{source}: line {line} of the file {SECOND_TABLE}: save each table in a file of its own")


def _refuse_odd_rows(body: str, separator: str, layout: Layout, source: str) -> None:
    """Say which row has another number of cells, or that a second table begins."""
    many = 0
    first: tuple[int, int, list[str]] | None = None
    named = False  # a line of names stands before the rows of another width
    row = 0
    for number, line in enumerate(body.split("\n")):
        cells = _all_cells(line, separator)
        if not any(cells):
            continue
        row += 1
        if len(cells) == layout.width:
            continue
        if not _holds_values(cells):
            named = named or (first is None and len(cells) > 1)
            continue
        many += 1
        first = first or (row, number + layout.first + 1, cells)
    if first is None:
        return
    row, line_number, cells = first
    if named and many > 1:
        raise RecordingError(
            f"{source}: line {line_number} {SECOND_TABLE} with {len(cells)} columns: "
            "save each table in a file of its own"
        )
    hint = (
        "write numbers with a decimal point, not a comma"
        if len(cells) > layout.width
        else "give every cell, an empty one for a gap"
    )
    raise RecordingError(
        f"{source}: row {row} (line {line_number} of the file) has {len(cells)} cells and the header has "
        f"{layout.width}: {hint}"
    )


def _all_cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _line_of(body: str, separator: str, layout: Layout, wanted: int) -> int:
    delimiter = "\t" if separator in (_SPACES, " ") else separator
    row = -1
    for number, line in enumerate(_tabbed(body, separator).split("\n")):
        if line.strip():
            row += len(_all_cells(line, delimiter)) >= layout.width
        if row == wanted:
            return number + layout.first + 1
    return wanted + layout.first + 1


# ---------------------------------------------------------------- workbooks and Parquet


def _of_workbook(data: bytes, source: str, prefix: str, most_rows: int) -> Table | None:
    from openpyxl import load_workbook  # noqa: PLC0415  - few files need it

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            most_bytes = bytes_of_rows(most_rows)
            require_size(sum(entry.file_size for entry in archive.infolist()), most_bytes, source)
        workbook = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = [(sheet.title, [_texts(row) for row in sheet.iter_rows()]) for sheet in workbook]
    except RecordingError:
        raise
    except (ValueError, KeyError, TypeError, OSError, zipfile.BadZipFile, zlib.error, SyntaxError) as error:
        raise RecordingError(f"{source}: it cannot be read as an xlsx workbook ({error}): save it again") from None
    found = [(name, rows, layout) for name, rows in sheets if (layout := find_layout(rows[:_HEAD_ROWS])) is not None]
    if not found:
        return None
    if len(found) > 1:
        raise RecordingError(
            f"{source}: the sheets {', '.join(repr(name) for name, _, _ in found)} hold a table each: leave one of them"
        )
    name, rows, layout = found[0]
    _refuse_another(layout, source)
    numbers = [number for number in range(layout.first, len(rows)) if rows[number]]
    end = next((at for at, number in enumerate(numbers) if not _is_row(rows[number])), len(numbers))
    if any(_is_row(rows[number]) for number in numbers[end:]):
        line = numbers[end] + 1
        raise RecordingError(
            f"{source}: line {line} of sheet {name!r} {SECOND_TABLE}: save each table in a file of its own"
        )
    kept = [_padded(rows[number], layout.width) for number in numbers[:end]]
    return Table(
        source=source,
        kind=f"{prefix}xlsx, sheet {name!r}, header in line {layout.header + 1}",
        headers=tuple(_padded(rows[layout.header], layout.width)),
        units=tuple([""] * layout.width if layout.units is None else _padded(rows[layout.units], layout.width)),
        columns=tuple(pa.array([row[at] for row in kept], pa.string()) for at in range(layout.width)),
        line_of=lambda row: numbers[row] + 1,
        left_out_lines=len(numbers) - end,
    )


def _is_row(cells: Sequence[str]) -> bool:
    return any(is_number(cell) or is_stamp(cell) for cell in cells)


def _texts(row: Sequence[Any]) -> list[str]:
    cells = [_text(cell.value, str(cell.number_format) if isinstance(cell.value, float | int) else "") for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _text(cell: Any, form: str = "") -> str:
    """Return a cell as a text; of one that is shown in percent as it is shown."""
    if "%" in form and not isinstance(cell, bool):
        return f"{100.0 * cell!r}%"
    if cell is None:
        return ""
    if isinstance(cell, datetime | date | time):
        return cell.isoformat(sep=" ") if isinstance(cell, datetime) else cell.isoformat()
    return repr(cell) if isinstance(cell, float) else str(cell).strip()


def _of_parquet(data: bytes, source: str, prefix: str, most_rows: int) -> Table | None:
    try:
        described = pq.read_metadata(io.BytesIO(data))
        if described.num_rows > most_rows:
            raise RecordingError(too_many_rows(source, described.num_rows, most_rows))
        unpacked = sum(described.row_group(number).total_byte_size for number in range(described.num_row_groups))
        require_size(unpacked, bytes_of_rows(most_rows), source)
        table = whole_table(data)
        columns = [table[at].cast(pa.string()).combine_chunks() for at in range(table.num_columns)]
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        reason = str(error).partition(".")[0]
        raise RecordingError(f"{source}: it cannot be read as a Parquet file ({reason}): write it again") from None
    if not columns or table.num_rows == 0:
        return None
    return Table(
        source=source,
        kind=f"{prefix}Parquet",
        headers=tuple(table.column_names),
        units=("",) * len(columns),
        columns=tuple(column.fill_null("") for column in _columns(columns)),
        line_of=lambda row: row + 1,
    )


def row_texts(table: Table, row: int) -> Iterator[str]:
    """Yield the cells of a row."""
    for column in table.columns:
        yield str(column[row].as_py()).strip()
