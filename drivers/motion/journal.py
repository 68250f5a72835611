"""The journal: samples of a running test on disk at once, so that a crash loses at most the last moment.

A text file in UTF-8, one record a line, each line closed by a space, the CRC-32 of what stands before that space
(8 hex digits) and a line feed. A line whose CRC does not fit (the last one after a crash) is left out.

::

    {"schema": "breakaway/journal/3", "test": "...", "valve": "...", ...} CRC         first line: what is recorded
    {"commanded_at": "2026-11-21T03:15:02.120431+00:00"} CRC                          the valve may move from here on
    time_s,sent_s,received_s,position_m,pressure_pa,command_pa,recorded,write_sent_s,written_s CRC  one line a sample

The second line is forced onto the disk before the first write that can move the valve is sent: without it nothing was
commanded. ``time_s`` counts from the start of the waveform; ``recorded`` is 0 for a sample that only watches a device
which captures by itself; ``nan`` is a gap. Journals of schema ``breakaway/journal/2`` do not say whether something was
commanded, those of ``breakaway/journal/1`` also lack the last two columns, in which the command was written; both are
still read. Every batch is handed to the operating system at once (it survives the death
of the process) and ``sync`` forces it onto the disk (it survives a power cut).
"""

from __future__ import annotations

import errno
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drivers.motion.synced import sync_folder
from drivers.outcome import SampleBlock
from valve.errors import RecordingError
from valve.messages import message_of, say
from valve.recording import Acquisition, Provenance, Recording

FloatArray = npt.NDArray[np.float64]
SCHEMA: Final = "breakaway/journal/3"
_COMMANDED: Final = "commanded_at"
_OLD_FIELDS: Final = ("time_s", "sent_s", "received_s", "position_m", "pressure_pa", "command_pa", "recorded")
_FIELDS: Final = (*_OLD_FIELDS, "write_sent_s", "written_s")
_FIELDS_OF: Final = {"breakaway/journal/1": _OLD_FIELDS, "breakaway/journal/2": _FIELDS, SCHEMA: _FIELDS}


def _line(text: str) -> bytes:
    data = text.encode()
    return b"%s %08x\n" % (data, zlib.crc32(data))


def _checked(line: bytes) -> str | None:
    """Return what stands in a line; None where its CRC does not fit."""
    text, _, crc = line.rpartition(b" ")
    return text.decode() if text and crc == b"%08x" % zlib.crc32(text) else None


def _checked_lines(data: bytes) -> Iterator[str]:
    return (text for text in map(_checked, data.split(b"\n")) if text is not None)


def _rows(block: SampleBlock) -> FloatArray:
    absent = np.full(block.time_s.shape, np.nan)
    return np.column_stack(
        (
            block.time_s,
            absent if block.sent_s is None else block.sent_s,
            absent if block.received_s is None else block.received_s,
            block.position_m,
            block.pressure_pa,
            block.command_pa,
            np.full(block.time_s.shape, float(block.recorded)),
            absent if block.write_sent_s is None else block.write_sent_s,
            absent if block.written_s is None else block.written_s,
        )
    )


class JournalWriter:
    """Appends to a new journal. Raises FileExistsError where there is one already: a run has one attempt."""

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        self._file = path.open("xb", buffering=0)
        self._file.write(_line(json.dumps({"schema": SCHEMA, **header})))
        os.fsync(self._file.fileno())
        self._unsynced = False
        sync_folder(path.parent)

    def note_commanded(self) -> None:
        """Write that the valve may move from now on; it is on disk when this returns. Raises OSError."""
        self._write(_line(json.dumps({_COMMANDED: datetime.now(UTC).isoformat()})))
        os.fsync(self._file.fileno())

    def append(self, block: SampleBlock) -> None:
        """Hand samples to the operating system. Raises OSError where the disk is full or broken."""
        data = b"".join(_line(",".join(map(repr, row))) for row in _rows(block).tolist())
        if data:
            self._write(data)
            self._unsynced = True

    def _write(self, data: bytes) -> None:
        written = self._file.write(data)
        if written != len(data):
            raise OSError(
                errno.ENOSPC, f"{written} of {len(data)} bytes were written, the disk is full", self._file.name
            )

    def sync(self) -> None:
        """Force what was appended onto the disk; may block, so callers on the event loop use a thread."""
        if self._unsynced:
            self._unsynced = False
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def was_commanded(path: Path) -> bool | None:
    """Whether a journal shows that something was sent which can move the valve; None where it cannot say it.

    True where its intent can be read, whatever else is damaged. False only where all of it can be read and holds no
    intent, which comes before every such write, and where there is no journal. A line without an end, the last after a
    crash, was not on the disk before anything was sent. Raises OSError.
    """
    try:
        *lines, _ = path.read_bytes().split(b"\n")
    except FileNotFoundError:
        return False
    texts = [_checked(line) for line in lines]
    if any(text is not None and text.startswith("{") and _COMMANDED in json.loads(text) for text in texts[1:]):
        return True
    header = json.loads(texts[0]) if texts and texts[0] is not None else {}
    only_header = len(texts) == 1 and header.get("schema") == SCHEMA  # samples come after the intent
    return False if only_header else None


def read_header(path: Path) -> dict[str, Any]:
    """Return the header of a journal alone. Raises RecordingError where it is missing or damaged, OSError."""
    with path.open("rb") as file:
        return _header(path, _checked_lines(file.readline().rstrip(b"\n")))


def _header(path: Path, lines: Iterator[str]) -> dict[str, Any]:
    try:
        header: dict[str, Any] = json.loads(next(lines, ""))
        if header.get("schema") not in tuple(_FIELDS_OF):
            raise ValueError(f"schema {header.get('schema')!r}")
    except (ValueError, AttributeError) as error:
        raise RecordingError(
            say(
                "journal_without_header",
                "{file}: it has no header of {schema} ({why}), nothing can be read",
                file=path.name,
                schema=SCHEMA,
                why=message_of(error),
            )
        ) from error
    return header


def read_journal(path: Path) -> tuple[dict[str, Any], FloatArray]:
    """Return the header and the samples of a journal, shape (n, 9), torn and damaged lines left out.

    What an older journal does not have is NaN.

    Raises RecordingError where the header itself is missing or damaged.
    """
    lines = _checked_lines(path.read_bytes())
    header = _header(path, lines)
    width = len(_FIELDS_OF[header["schema"]])
    rows = [[float(cell) for cell in line.split(",")] for line in lines if not line.startswith("{")]
    known = np.array([row for row in rows if len(row) == width], dtype=np.float64).reshape(-1, width)
    return header, np.pad(known, ((0, 0), (0, len(_FIELDS) - width)), constant_values=np.nan)


def _in_order(rows: FloatArray) -> FloatArray:
    """Rows with a finite time that is later than all before it."""
    rows = rows[np.isfinite(rows[:, 0])]
    latest_s = np.maximum.accumulate(rows[:, 0])
    return rows[np.concatenate(([True], rows[1:, 0] > latest_s[:-1]))] if len(rows) else rows


def _channel(column: FloatArray) -> FloatArray | None:
    return column if bool(np.isfinite(column).any()) else None


def recording_from_journal(path: Path) -> Recording | None:
    """Return what a journal holds as a recording; None where it has no two samples with a command or a pressure.

    Recorded samples where there are two of them, otherwise those that watched.
    """
    header, rows = read_journal(path)
    recorded = _in_order(rows[rows[:, 6] == 1.0])
    chosen = recorded if len(recorded) >= 2 else _in_order(rows)
    time_s, sent_s, received_s, position_m, pressure_pa, command_pa, _, write_sent_s, written_s = chosen.T
    if len(chosen) < 2 or (_channel(pressure_pa) is None and _channel(command_pa) is None):
        return None
    captured = len(recorded) >= 2 and _channel(sent_s) is None
    return Recording(
        time_s=time_s,
        position_m=position_m,
        pressure_pa=_channel(pressure_pa),
        command_pa=_channel(command_pa),
        sent_s=_channel(sent_s),
        received_s=_channel(received_s),
        write_sent_s=_channel(write_sent_s),
        written_s=_channel(written_s),
        provenance=Provenance(
            acquisition=Acquisition.CAPTURED if captured else Acquisition.POLLED,
            tag=str(header.get("valve", "")),
            sequence=str(header.get("sequence", "")),
            started_at=str(header.get("started_at", "")),
            software=str(header.get("software", "")),
            device=str(header.get("device", "")),
            notes=say("from_journal", "what the journal of an interrupted test holds"),
        ),
    )
