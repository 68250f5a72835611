"""Recordings as Parquet: integers with a scale where a channel is quantised, float64 where it is not; lossless."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from valve.column_names import remedy
from valve.errors import RecordingError
from valve.messages import say
from valve.quantisation import Grid, find_grid
from valve.recording import Acquisition, FloatArray, Provenance
from valve.recording_csv import COLUMNS, too_many_rows

SCHEMA: Final = "breakaway/recording/1"
_METADATA_KEY: Final = b"breakaway"
_UNITS: Final = {"s": "s", "pa": "Pa", "n": "N", "m": "m"}  # by the last part of a column's name
_INT32: Final = 2**31 - 1
_BYTES_A_NUMBER: Final = 16  # 8, and as much again for a dictionary and the pages' heads


def parquet_bytes(columns: Mapping[str, FloatArray], provenance: Provenance, sample_period_s: float) -> bytes:
    """Return a Parquet file of these columns, shape (n,) each, in the unit that the name ends in.

    A column whose every value is exactly ``scale * n / divisor + offset`` for whole n is kept as n; any other as
    float64. The schema's metadata under ``breakaway`` says the unit, the scale, the rate and where the data come from.
    """
    arrays: dict[str, pa.Array] = {}
    described: dict[str, dict[str, Any]] = {}
    encodings: dict[str, str] = {}
    for name, column in columns.items():
        described[name] = {"unit": _UNITS[name.rpartition("_")[2]]}
        grid = find_grid(column)
        if grid is None:
            arrays[name] = pa.array(column, type=pa.float64(), from_pandas=True)
            encodings[name] = "BYTE_STREAM_SPLIT"
            continue
        described[name] |= asdict(grid)
        arrays[name] = _integers(grid.whole_numbers(column), np.isnan(column))
        encodings[name] = "DELTA_BINARY_PACKED"
    metadata = {
        "schema": SCHEMA,
        "columns": described,
        "sample_period_s": sample_period_s if np.isfinite(sample_period_s) else None,
        "provenance": asdict(provenance),
    }
    table = pa.table(arrays).replace_schema_metadata({_METADATA_KEY: json.dumps(metadata, allow_nan=False).encode()})
    sink = io.BytesIO()
    pq.write_table(
        table, sink, compression="zstd", compression_level=9, use_dictionary=False, column_encoding=encodings
    )
    return sink.getvalue()


def _integers(numbers: FloatArray, missing: np.typing.NDArray[np.bool_]) -> pa.Array:
    whole = np.where(missing, 0.0, numbers).astype(np.int64)
    fits = bool(np.abs(whole).max(initial=0) <= _INT32)
    return pa.array(whole.astype(np.int32) if fits else whole, mask=missing)


def read_columns(data: bytes, source: str, *, most_rows: int) -> tuple[dict[str, FloatArray], Provenance]:
    """Columns by name, float64 with NaN for gaps, and the provenance (of a file of others: empty).

    Raises RecordingError where it is no Parquet file, or a column is unknown or holds no numbers; of more rows than
    ``most_rows``, or bytes than so many of numbers have, before anything is unpacked.
    """
    try:
        described = pq.read_metadata(io.BytesIO(data))
        if described.num_rows > most_rows:
            raise RecordingError(too_many_rows(source, described.num_rows, most_rows))
        _require_known(described.schema.to_arrow_schema().names, source)
        _require_modest(described, most_rows, source)
        table = whole_table(data)
    except (pa.ArrowInvalid, OSError) as error:
        reason = str(error).partition(".")[0]
        raise RecordingError(
            say(
                "no_parquet_file",
                "{source}: it cannot be read as a Parquet file ({why}): write it again",
                source=source,
                why=reason,
            )
        ) from None
    metadata = _metadata(table.schema, source)
    columns: dict[str, FloatArray] = {}
    for name in table.column_names:
        columns[name] = _values(
            table[name],
            metadata.get("columns", {}).get(name, {}),
            say("column_of_file", "{source}: column {column}", source=source, column=name),
        )
    return columns, _provenance(metadata, source)


def whole_table(data: bytes) -> pa.Table:
    """Every column of a Parquet file. Raises ArrowInvalid or OSError where it is none."""
    # pq.read_table would load pyarrow.dataset first: ten libraries, while every other thread waits for the disk.
    # One thread: more gain nothing here, and hang where memory is bounded and none can be started.
    with pq.ParquetFile(io.BytesIO(data), pre_buffer=False) as file:
        return file.read(use_threads=False)


def _require_known(names: Sequence[str], source: str) -> None:
    for number, name in enumerate(names):
        if name not in COLUMNS:
            raise RecordingError(
                say(
                    "column_unknown",
                    "{source}: unknown column {column}; there are {known:, }: {remedy}",
                    source=source,
                    column=repr(name),
                    known=tuple(COLUMNS),
                    remedy=remedy(name),
                )
            )
        if name in names[:number]:
            raise RecordingError(
                say(
                    "column_twice",
                    "{source}: column {column} stands in it twice, remove one",
                    source=source,
                    column=repr(name),
                )
            )


def _require_modest(described: pq.FileMetaData, most_rows: int, source: str) -> None:
    """Refuse what unpacks to more bytes than numbers in so many rows have: long texts, a dictionary of millions."""
    unpacked = sum(described.row_group(number).total_byte_size for number in range(described.num_row_groups))
    most = _BYTES_A_NUMBER * described.num_columns * most_rows
    if unpacked > most:
        raise RecordingError(
            say(
                "unpacks_to_much",
                "{source}: it unpacks to {unpacked} bytes, the most is {most}: write numbers alone",
                source=source,
                unpacked=unpacked,
                most=most,
            )
        )


def _metadata(schema: pa.Schema, source: str) -> dict[str, Any]:
    packed = (schema.metadata or {}).get(_METADATA_KEY)
    if packed is None:
        return {}
    try:
        metadata = json.loads(packed)
    except ValueError:
        metadata = None
    if not isinstance(metadata, dict) or metadata.get("schema") != SCHEMA:
        raise RecordingError(
            say(
                "metadata_schema",
                "{source}: its metadata is not {schema}: read it with the version that wrote it",
                source=source,
                schema=SCHEMA,
            )
        )
    return metadata


def _values(column: pa.ChunkedArray, described: Mapping[str, Any], where: str) -> FloatArray:
    try:
        numbers = np.array(pc.cast(column, pa.float64()).to_numpy(), dtype=np.float64)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        raise RecordingError(
            say(
                "column_no_numbers",
                "{where} holds {kind}, it must hold numbers: convert it",
                where=where,
                kind=str(column.type),
            )
        ) from None
    if "scale" not in described:
        return numbers
    try:
        return Grid(described["scale"], described["offset"], described["divisor"]).values(numbers)
    except (KeyError, TypeError):
        raise RecordingError(
            say("grid_no_numbers", "{where}: scale, offset and divisor in its metadata must be numbers", where=where)
        ) from None


def _provenance(metadata: Mapping[str, Any], source: str) -> Provenance:
    given = metadata.get("provenance", {})
    known = {entry.name for entry in fields(Provenance)}
    try:
        kept = {name: value for name, value in given.items() if name in known}
        return Provenance(**kept | {"acquisition": Acquisition(kept.get("acquisition", Acquisition.FILE))})
    except (AttributeError, ValueError):
        raise RecordingError(
            say("provenance_unknown", "{source}: its metadata says no known provenance, write it again", source=source)
        ) from None
