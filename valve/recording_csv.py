"""Recordings as CSV: a fast reader for good files and a careful one that says where a bad file is wrong."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.csv

from valve.column_names import remedy
from valve.errors import RecordingError
from valve.messages import say
from valve.recording import CHANNELS, INTERVAL_CHANNELS, FloatArray

COLUMNS: Final = ("time_s", *CHANNELS, "command_ma", *INTERVAL_CHANNELS)
_GAPS: Final = ("", "nan", "NaN", "NAN")
_LONGEST_SHOWN: Final = 40  # characters of a bad cell that a message repeats


def read_columns(data: bytes, source: str, *, most_rows: int) -> dict[str, FloatArray]:
    """Columns of a CSV file by name, float64, NaN where a cell is empty or ``nan``.

    Raises RecordingError with file, row, column, value and remedy.
    """
    header, body_start = _header(data, source)
    body = data[body_start:]
    if not body.strip():
        raise RecordingError(
            say("header_without_rows", "{source}: it has a header and no row, give one row a sample", source=source)
        )
    if body.count(b"\n") > most_rows:
        raise RecordingError(too_many_rows(source, body.count(b"\n"), most_rows))
    try:
        table = pa.csv.read_csv(
            io.BytesIO(body),
            read_options=pa.csv.ReadOptions(column_names=header),
            convert_options=pa.csv.ConvertOptions(
                column_types=dict.fromkeys(header, pa.float64()), null_values=list(_GAPS), strings_can_be_null=True
            ),
        )
    except pa.ArrowInvalid as error:
        raise _located(body, header, source) or RecordingError(
            say("no_csv_file", "{source}: it is not a CSV file: {why}", source=source, why=str(error))
        ) from None
    return {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in header}


def too_many_rows(source: str, rows: int, most_rows: int) -> str:
    """Return what is said of a file with more rows than are taken."""
    return say(
        "too_many_rows",
        "{source}: it has {rows} rows, the most is {most_rows}: give fewer or shorter recordings",
        source=source,
        rows=rows,
        most_rows=most_rows,
    )


def csv_bytes(columns: Mapping[str, FloatArray]) -> bytes:
    """Return a CSV file: the header, then one row a sample; a gap is an empty cell, a number reads back bitwise.

    ``columns``: shape (n,) each, in the unit that the name ends in.
    """
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    sink = io.BytesIO()
    sink.write((",".join(columns) + "\n").encode())
    pa.csv.write_csv(table, sink, pa.csv.WriteOptions(include_header=False, quoting_style="none"))
    return sink.getvalue()


def _header(data: bytes, source: str) -> tuple[list[str], int]:
    """Column names, checked, and where the first row starts."""
    start = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    if not data[start:].strip():
        raise RecordingError(
            say("file_empty", "{source}: the file is empty, give a header line and one row a sample", source=source)
        )
    while data[start : start + 1] in (b"\n", b"\r"):
        start += 1
    end = data.find(b"\n", start)
    end = len(data) if end < 0 else end
    try:
        line = data[start:end].decode("utf-8").strip("\r")
    except UnicodeDecodeError:
        raise RecordingError(
            say(
                "no_utf8_text",
                "{source}: it is no text in UTF-8: give a CSV file saved as UTF-8, or a Parquet file",
                source=source,
            )
        ) from None
    names = [cell.strip().strip('"').strip() for cell in line.split(",")]
    if len(names) == 1 and (";" in line or "\t" in line) and not data[end:].strip():
        raise RecordingError(
            say(
                "header_alone",
                "{source}: it has a header line and no rows: export a time that has values",
                source=source,
            )
        )
    _require_known(names, line, source)
    return names, min(end + 1, len(data))


def _require_known(names: list[str], line: str, source: str) -> None:
    known = tuple(COLUMNS)
    for separator, called in ((";", say("semicolons", "semicolons")), ("\t", say("tabs", "tabs"))):
        if len(names) == 1 and separator in line:
            raise RecordingError(
                say(
                    "columns_between",
                    "{source}: its columns stand between {called}, they must stand between commas and numbers must "
                    "have a decimal point: save it so",
                    source=source,
                    called=called,
                )
            )
    if all(_is_number(name) for name in names):
        raise RecordingError(
            say(
                "header_of_numbers",
                "{source}: row 1 holds numbers, it must be a header line with names out of {known:, }",
                source=source,
                known=known,
            )
        )
    for name in names:
        if name not in COLUMNS:
            raise RecordingError(
                say(
                    "column_unknown",
                    "{source}: unknown column {column}; there are {known:, }: {remedy}",
                    source=source,
                    column=repr(name[:_LONGEST_SHOWN]),
                    known=known,
                    remedy=remedy(name),
                )
            )
        if names.count(name) > 1:
            raise RecordingError(
                say(
                    "column_twice",
                    "{source}: column {column} stands in it twice, remove one",
                    source=source,
                    column=repr(name),
                )
            )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _lines(body: bytes) -> Iterator[list[str]]:
    return csv.reader(io.StringIO(body.decode("utf-8", errors="replace")))


def _located(body: bytes, header: list[str], source: str) -> RecordingError | None:
    """Name the first cell that is wrong; None where all cells are numbers."""
    row = 0
    for cells in _lines(body):
        if not cells:
            continue
        row += 1
        where = say(
            "row_of_file", "{source}: row {row} (line {line} of the file)", source=source, row=row, line=row + 1
        )
        if len(cells) != len(header):
            hint = (
                say("no_decimal_comma", "write numbers with a decimal point, not a comma")
                if len(cells) > len(header)
                else say("every_cell_needed", "give every cell, an empty one for a gap")
            )
            return RecordingError(
                say(
                    "cells_do_not_match",
                    "{where} has {cells} cells and the header has {columns}: {hint}",
                    where=where,
                    cells=len(cells),
                    columns=len(header),
                    hint=hint,
                )
            )
        for name, cell in zip(header, cells, strict=True):
            text = cell.strip()
            if text not in _GAPS and not _is_number(text):
                comma = "," in text and _is_number(text.replace(",", "."))
                hint = (
                    say("write_decimal_point", "write it with a decimal point")
                    if comma
                    else say("give_number_or_nothing", "give a number, or nothing for a gap")
                )
                return RecordingError(
                    say(
                        "cell_is_no_number",
                        "{where}, column {column}: {text} is not a number: {hint}",
                        where=where,
                        column=name,
                        text=repr(text[:_LONGEST_SHOWN]),
                        hint=hint,
                    )
                )
    return None
