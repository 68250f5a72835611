"""Recording files: CSV with SI names in its header, or Parquet with the same columns."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from valve import recording_csv, recording_parquet
from valve.errors import RecordingError
from valve.messages import say
from valve.nameplate import Nameplate
from valve.plausibility import (
    require_channels_in_place,
    require_moving_input,
    require_no_stand_ins,
    require_plausible_current,
    require_plausible_position,
    require_plausible_pressure,
    require_plausible_time,
)
from valve.recording import CHANNELS, INTERVAL_CHANNELS, Acquisition, FloatArray, Provenance, Recording, clock_set_back

_FEWEST_OF_A_PART: Final = 10  # rows before and after a clock that was set back: else a row is out of order
_PARQUET_MAGIC: Final = b"PAR1"
_PARQUET_SUFFIXES: Final = (".parquet", ".pq")
_POLLED_COLUMNS: Final = frozenset(INTERVAL_CHANNELS)  # a write and a look a row: nothing else has them
_LARGEST_FILE_BYTES: Final = 2**31  # 10 hours of 1 kHz are 1 GB of CSV; more is no test of a valve
_MOST_ROWS: Final = 72_000_000  # 20 hours of 1 kHz


def read_recording(path: Path | str, nameplate: Nameplate | None = None, *, most_rows: int | None = None) -> Recording:
    """Recording of a CSV or a Parquet file, told apart by their content.

    ``command_ma`` becomes ``command_pa`` by the nameplate's signal. With a nameplate, values that cannot be in SI
    units are refused, and with ``most_rows`` a file that has more, before it is unpacked.
    Raises RecordingError with file, row, column, value, limit and remedy.
    """
    source = str(path)
    data = file_content(Path(path))
    says_parquet = Path(path).suffix in _PARQUET_SUFFIXES
    return recording_from_bytes(data, source, nameplate, says_parquet=says_parquet, most_rows=most_rows)


def recording_from_bytes(
    data: bytes,
    source: str,
    nameplate: Nameplate | None = None,
    *,
    says_parquet: bool = False,
    most_rows: int | None = None,
    in_service: bool = False,
) -> Recording:
    """Recording of a file's content; ``source`` names it in messages.

    ``in_service``: rows of a historian may be slow and span days. Raises RecordingError as ``read_recording``.
    """
    provenance = Provenance()
    most_rows = _MOST_ROWS if most_rows is None else most_rows
    if data.startswith(_PARQUET_MAGIC):
        columns, provenance = recording_parquet.read_columns(data, source, most_rows=most_rows)
    elif says_parquet:
        raise RecordingError(
            say(
                "not_as_parquet_starts",
                "{source}: it does not start as a Parquet file does: give it the suffix of what it is",
                source=source,
            )
        )
    else:
        columns = recording_csv.read_columns(data, source, most_rows=most_rows)
    return recording_from_columns(columns, provenance, source, nameplate, in_service=in_service)


def write_csv(recording: Recording, path: Path | str) -> None:
    """Write all channels as CSV, gaps as empty cells; every number reads back bit by bit. Replaces the file at once."""
    _write_durably(recording_csv.csv_bytes(recording_columns(recording)), Path(path))


def write_parquet(recording: Recording, path: Path | str) -> str:
    """Write all channels and the provenance as Parquet, lossless, and return the file's SHA-256 in hex.

    The file is complete, under its name and on the disk when this returns, or not there at all.
    """
    data = recording_parquet.parquet_bytes(
        recording_columns(recording), recording.provenance, recording.sample_period_s
    )
    _write_durably(data, Path(path))
    return hashlib.sha256(data).hexdigest()


def file_sha256(path: Path | str) -> str:
    """SHA-256 of a file's content in hex. Raises RecordingError where it cannot be read."""
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(
            say("file_unreadable", "{path}: it cannot be read: {why}", path=str(path), why=error.strerror or "")
        ) from None


def recording_columns(recording: Recording) -> dict[str, FloatArray]:
    """Columns that a file of this recording has, by name, in their order."""
    columns = {"time_s": recording.time_s}
    for name in (*CHANNELS, *INTERVAL_CHANNELS):
        channel = getattr(recording, name)
        if channel is not None:
            columns[name] = channel
    return columns


def file_content(path: Path) -> bytes:
    """Return a file's bytes. Raises RecordingError where it cannot be read or is too large for a recording."""
    try:
        if path.is_dir():
            raise RecordingError(
                say("path_is_folder", "{path}: it is a folder, give a CSV or Parquet file", path=str(path))
            )
        size = path.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise RecordingError(
                say(
                    "file_too_large",
                    "{path}: it has {size} bytes, a recording may have {largest_file_bytes}: cut it into parts",
                    path=str(path),
                    size=size,
                    largest_file_bytes=_LARGEST_FILE_BYTES,
                )
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise RecordingError(
            say("no_such_file", "{path}: there is no such file, check its name", path=str(path))
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise RecordingError(
            say("file_unreadable", "{path}: it cannot be read: {why}", path=str(path), why=reason or "")
        ) from None


def _write_durably(data: bytes, path: Path) -> None:
    """Write under a temporary name, force to disk, then rename: a reader never sees half a file."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise RecordingError(
            say("file_unwritable", "{path}: it cannot be written: {why}", path=str(path), why=error.strerror or "")
        ) from error


def recording_from_columns(
    columns: dict[str, FloatArray],
    provenance: Provenance,
    source: str,
    nameplate: Nameplate | None,
    *,
    in_service: bool = False,
) -> Recording:
    """Recording of columns by the contract's names, each requirement checked with the file's name in the message.

    Raises RecordingError as ``read_recording``. ``columns``: shape (n,) each, in the unit that the name ends in.
    """
    _require_columns(columns, source)
    _require_rising_time(columns["time_s"], source)
    for name, column in columns.items():
        if np.isinf(column).any():
            row = int(np.isinf(column).argmax()) + 1
            raise RecordingError(
                say(
                    "infinite_in_column",
                    "{source}: row {row}, column {column}: it is infinite, leave a gap empty",
                    source=source,
                    row=row,
                    column=name,
                )
            )
        if np.isnan(column).all() and name in ("position_m", "force_n", "pressure_pa"):
            raise RecordingError(
                say(
                    "column_without_value",
                    "{source}: column {column} holds no value, {remedy}",
                    source=source,
                    column=name,
                    remedy=_remedy(name),
                )
            )
    if nameplate is not None:
        _require_plausible(columns, nameplate, source, in_service=in_service)
    for name in ("position_m", "pressure_pa", "command_pa", "force_n"):
        if name in columns:
            require_no_stand_ins(name, columns[name], source)
    if "command_ma" in columns:
        columns["command_pa"] = _command_pa(columns.pop("command_ma"), nameplate, source)
    if provenance.acquisition is Acquisition.FILE and columns.keys() >= _POLLED_COLUMNS:
        provenance = replace(provenance, acquisition=Acquisition.POLLED)  # a CSV does not say it otherwise
    return Recording(**columns, provenance=provenance)


def _remedy(name: str) -> str:
    if name == "position_m":
        return say("give_samples", "give its samples")
    return say("remove_or_give_samples", "remove it or give its samples")


def _require_columns(columns: dict[str, FloatArray], source: str) -> None:
    for name in ("time_s", "position_m"):
        if name not in columns:
            raise RecordingError(
                say(
                    "column_missing",
                    "{source}: column {column} is missing, a recording needs it: add it",
                    source=source,
                    column=name,
                )
            )
    if columns["time_s"].size == 0:
        raise RecordingError(
            say("columns_without_rows", "{source}: it has columns and no row, give one row a sample", source=source)
        )
    if not columns.keys() & {"command_pa", "command_ma", "pressure_pa", "force_n"}:
        raise RecordingError(
            say(
                "no_input_column",
                "{source}: none of the columns command_pa, command_ma, pressure_pa and force_n is there: add one",
                source=source,
            )
        )
    if {"command_pa", "command_ma"} <= columns.keys():
        raise RecordingError(
            say("two_commands", "{source}: command_pa and command_ma are both there, remove one", source=source)
        )


def _require_rising_time(time_s: FloatArray, source: str) -> None:
    if np.isnan(time_s).any():
        row = int(np.isnan(time_s).argmax()) + 1
        raise RecordingError(
            say(
                "time_missing_in_row",
                "{source}: row {row}, column time_s: it is missing, every row needs a time",
                source=source,
                row=row,
            )
        )
    falling = np.flatnonzero(np.diff(time_s) <= 0.0)
    if falling.size > 1 and falling.size == time_s.size - 1 and np.diff(time_s).max() < 0.0:
        raise RecordingError(
            say(
                "newest_row_first",
                "{source}: column time_s: the newest row stands first, from {first} down to {last} s, it must "
                "increase: sort the rows by time",
                source=source,
                first=float(time_s[0]),
                last=float(time_s[-1]),
            )
        )
    if falling.size:
        row = int(falling[0]) + 2
        before_s, after_s = float(time_s[row - 2]), float(time_s[row - 1])
        if falling.size == 1 and after_s < before_s and _FEWEST_OF_A_PART < row <= time_s.size - _FEWEST_OF_A_PART:
            raise RecordingError(clock_set_back(source, row, before_s, after_s))
        raise RecordingError(
            say(
                "time_falls_in_row",
                "{source}: row {row}, column time_s: time goes from {before} to {after} s, it must increase: put the "
                "rows in order and remove doubled ones",
                source=source,
                row=row,
                before=before_s,
                after=after_s,
            )
        )


def _require_plausible(columns: dict[str, FloatArray], nameplate: Nameplate, source: str, *, in_service: bool) -> None:
    position = columns["position_m"]
    require_plausible_time(columns["time_s"], source, in_service=in_service)
    if "pressure_pa" in columns:
        require_channels_in_place(position, columns["pressure_pa"], nameplate, source)
    require_plausible_position(position, nameplate, source)
    if "command_pa" in columns:
        require_plausible_pressure("command_pa", columns["command_pa"], position, nameplate, source)
    if "pressure_pa" in columns:
        require_plausible_pressure(
            "pressure_pa", columns["pressure_pa"], position, nameplate, source, command_pa=columns.get("command_pa")
        )
    if "command_ma" in columns:
        require_plausible_current(columns["command_ma"], source)
    inputs_pa: dict[str, FloatArray] = {
        name: columns[name] for name in ("pressure_pa", "command_pa") if name in columns
    }
    if not columns.keys() & {"command_ma", "force_n"}:
        require_moving_input(inputs_pa, position, nameplate, source)


def _command_pa(command_ma: FloatArray, nameplate: Nameplate | None, source: str) -> FloatArray:
    if nameplate is None or nameplate.signal is None:
        subject = (
            say("no_nameplate_given", "no nameplate is given")
            if nameplate is None
            else say("nameplate_without_signal", "the nameplate of {tag} has no [signal]", tag=nameplate.tag)
        )
        raise RecordingError(
            say(
                "current_needs_signal",
                "{source}: the command is in mA and {subject}: give signal.range_ma and signal.range_pa, or command_pa",
                source=source,
                subject=subject,
            )
        )
    (low_ma, high_ma), (low_pa, high_pa) = nameplate.signal.range_ma, nameplate.signal.range_pa
    return np.asarray(low_pa + (command_ma - low_ma) * ((high_pa - low_pa) / (high_ma - low_ma)))
