"""Samples of a valve in service on disk: a file a valve and day, appended to, readable whenever its writer dies.

The first line is text as in the journal: JSON, a space, its CRC-32, a line feed. Blocks of rows follow, each with a
head of 12 bytes (``BWW1``, number of rows, CRC-32 of the rows; little endian) and 20 bytes a row: time (float64, s
since 1970 in UTC), position (m), pressure and command (Pa), float32 each; NaN is a gap. A block that was torn or
damaged is left out. Whoever goes on with a file cuts its torn end off first; one whose header is damaged is kept beside
the new one that is begun.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, unquote

import numpy as np
import numpy.typing as npt

from drivers.motion.synced import sync_folder
from valve.errors import RecordingError
from valve.messages import message_of, say

FloatArray = npt.NDArray[np.float64]
SCHEMA: Final = "breakaway/watched/1"
SUFFIX: Final = ".watch"
MOST_ROWS: Final = 1_000_000  # of a file: 20 MB, a day that moves all the time at 10 Hz
_HEAD: Final = struct.Struct("<4sII")
_MAGIC: Final = b"BWW1"
_ROW: Final = np.dtype([("time_s", "<f8"), ("position_m", "<f4"), ("pressure_pa", "<f4"), ("command_pa", "<f4")])
_DAMAGED: Final = ".damaged"  # behind the name of a file that was put aside, and a number where there are more
_LONGEST_NAME: Final = 120
_LONGEST_LINE: Final = 65536


@dataclass(frozen=True, slots=True)
class WatchDay:
    """The samples of one valve and day: where they are. The day is that on which its watching begins."""

    tag: str
    day: date
    path: Path


def folder_of(folder: Path, tag: str) -> Path:
    """Return the folder of a valve below that of all watched ones; a tag never names another place."""
    name = quote(tag, safe="").replace(".", "%2E")
    if len(name) > _LONGEST_NAME:
        name = f"{name[:80].rpartition('%')[0] or name[:80]}-{hashlib.sha256(tag.encode()).hexdigest()[:24]}"
    return folder / name


def day_of(folder: Path, tag: str, day: date) -> WatchDay:
    """Return where the samples of a valve and day are, or would be."""
    return WatchDay(tag, day, folder_of(folder, tag) / f"{day:%Y-%m-%d}{SUFFIX}")


def days_in(folder: Path, tag: str | None = None) -> list[WatchDay]:
    """Return the files that are there, by valve and day: of one valve, or of all. Blocks."""
    homes = [folder_of(folder, tag)] if tag is not None else sorted(folder.iterdir()) if folder.is_dir() else []
    found = []
    for home in homes:
        for path in sorted(home.glob(f"*{SUFFIX}")):
            try:
                day = date.fromisoformat(path.stem)
                found.append(WatchDay(unquote(home.name) if tag is None else tag, day, path))
            except ValueError:
                continue  # no file of ours
    return found


def remove_day(day: WatchDay) -> None:
    """Remove the file of a valve and day, and what was put aside of it. Raises OSError."""
    for aside in day.path.parent.glob(f"{day.path.name}{_DAMAGED}*"):
        aside.unlink(missing_ok=True)
    day.path.unlink(missing_ok=True)


def _put_aside(path: Path) -> Path:
    """Rename a file whose header is damaged; what was put aside before stays."""
    number, aside = 1, path.with_name(f"{path.name}{_DAMAGED}")
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.name}{_DAMAGED}-{number}")
    path.rename(aside)
    return aside


class WatchFileWriter:
    """Goes on with the file of a valve and day, or begins it with ``header``. All methods block. Raises OSError.

    ``aside`` is where a file whose header is damaged was put; None where there was none.
    """

    def __init__(self, day: WatchDay, header: Mapping[str, Any]) -> None:
        path = day.path
        path.parent.mkdir(parents=True, exist_ok=True)
        whole, self.rows = _whole(path) if path.exists() else (0, 0)
        self.aside = _put_aside(path) if not whole and path.exists() and path.stat().st_size else None
        self._file = path.open("r+b" if whole else "wb", buffering=0)
        if whole:
            self._file.truncate(whole)
            self._file.seek(whole)
            return
        text = json.dumps({"schema": SCHEMA, "valve": day.tag, "day": f"{day.day:%Y-%m-%d}", **header}).encode()
        self._write(b"%s %08x\n" % (text, zlib.crc32(text)))
        sync_folder(path.parent)

    def append(self, rows: FloatArray) -> None:
        """Hand rows, shape (n, 4), in s, m, Pa and Pa, to the operating system so that they survive this process."""
        packed = np.empty(len(rows), _ROW)
        for place, name in enumerate(_ROW.names or ()):
            packed[name] = rows[:, place]
        data = packed.tobytes()
        self._write(_HEAD.pack(_MAGIC, len(rows), zlib.crc32(data)) + data)
        self.rows += len(rows)

    def _write(self, data: bytes) -> None:
        written = self._file.write(data)
        if written != len(data):
            raise OSError(errno.ENOSPC, f"{written} of {len(data)} bytes were written, the disk is full")

    def close(self) -> None:
        """Force what was appended onto the disk, and close the file."""
        try:
            os.fdatasync(self._file.fileno())
        finally:
            self._file.close()


def read_watch_file(path: Path) -> tuple[dict[str, Any], FloatArray]:
    """Return the header and the rows of a file, shape (n, 4), as they were written, what is torn or damaged left out.

    Times go back where the clock was set back. Raises RecordingError where the header is missing or damaged, OSError.
    """
    data = path.read_bytes()
    header = _header(path, data)
    parts = [rows for _, rows in _blocks(data)]
    rows = np.concatenate(parts) if parts else np.empty(0, _ROW)
    columns = np.column_stack([rows[name].astype(np.float64) for name in _ROW.names or ()])
    return header, columns[np.isfinite(columns[:, 0])]


def _header(path: Path, data: bytes) -> dict[str, Any]:
    text, _, crc = data[:_LONGEST_LINE].partition(b"\n")[0].rpartition(b" ")
    try:
        if crc != b"%08x" % zlib.crc32(text):
            raise ValueError("its check does not fit")
        header: dict[str, Any] = json.loads(text)
        if header.get("schema") != SCHEMA:
            raise ValueError(f"schema {header.get('schema')!r}")
    except (ValueError, AttributeError) as error:
        raise RecordingError(
            say(
                "watch_file_without_header",
                "{file}: it has no header of {schema} ({why}), nothing can be read: remove the file",
                file=path.name,
                schema=SCHEMA,
                why=message_of(error),
            )
        ) from error
    return header


def _blocks(data: bytes) -> Iterator[tuple[int, np.ndarray[Any, Any]]]:
    """Yield where each whole block ends, and its rows; behind a damaged one the next is looked for."""
    place = data.find(b"\n") + 1
    while (place := data.find(_MAGIC, place)) >= 0 and place + _HEAD.size <= len(data):
        _, count, crc = _HEAD.unpack_from(data, place)
        end = place + _HEAD.size + count * _ROW.itemsize
        packed = data[place + _HEAD.size : end]
        if end > len(data) or zlib.crc32(packed) != crc:
            place += 1
            continue
        yield end, np.frombuffer(packed, _ROW)
        place = end


def _whole(path: Path) -> tuple[int, int]:
    """Return up to where a file is whole, and how many rows that is; 0 where not even its header is."""
    data = path.read_bytes()
    try:
        _header(path, data)
    except RecordingError:
        return 0, 0
    whole = [(data.find(b"\n") + 1, 0), *((end, len(block)) for end, block in _blocks(data))]
    return whole[-1][0], sum(rows for _, rows in whole)
