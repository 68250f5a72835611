"""Writing the audit log: append-only, on disk when ``append`` returns, one file a gateway.

An entry that a crash or a full disk cut short has no line feed, and was never answered for. The next ``append`` takes
it off and tells so, with what it held, in an entry of its own (``audit.torn``): what a crash does stays apart from
tampering, because every line that is whole must be an entry that follows the one before.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import threading
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from drivers.motion.audit_entries import Entry, chain_start, read_entry
from drivers.motion.synced import sync_folder
from valve.errors import InternalError
from valve.messages import message_of, say

TORN: Final = "audit.torn"
SUFFIX: Final = ".audit"
_SHOWN: Final = 4096  # bytes of a cut entry that are kept
_LONGEST: Final = 64 * 1024  # bytes of one entry; the permissives and the waveform of a test are below 8 KiB
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


class AuditError(InternalError):
    """The audit log cannot be written, so nothing that it must hold may happen."""


class AuditLog:
    """The log of one gateway, in ``folder``; threads and processes may append to the same one.

    Raises AuditError where the file cannot be opened, or its last entry is none of ours.
    """

    def __init__(self, folder: Path, gateway: str = "gateway") -> None:
        if _NAME.fullmatch(gateway) is None:
            raise AuditError(
                say(
                    "gateway_makes_no_file_name",
                    "the gateway's name {gateway} makes no file name: use letters, digits, . _ -",
                    gateway=repr(gateway[:80]),
                )
            )
        self.path = folder / f"{gateway}{SUFFIX}"
        self._start = chain_start(gateway)
        self._lock = threading.Lock()
        self._end: tuple[int, int, str] | None = None  # size in bytes, count and hash of the last entry
        with self._opened() as descriptor:
            self._known_end(descriptor)

    def append(
        self, event: str, *, who: str, valve: str = "", test: str = "", details: Mapping[str, Any] | None = None
    ) -> None:
        """Write what happens; it is on disk when this returns. May block for as long as the disk does.

        Raises AuditError where it cannot be written: then it must not happen.
        """
        with self._opened() as descriptor:
            self._write(descriptor, event, who=who, valve=valve, test=test, details=details)

    @property
    def head(self) -> tuple[int, str]:
        """Count and hash of the last entry."""
        with self._opened() as descriptor:
            _, count, last = self._known_end(descriptor)
        return count, last

    @contextlib.contextmanager
    def _opened(self) -> Iterator[int]:
        try:
            with self._lock:
                self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
                descriptor = os.open(self.path, flags, 0o600)
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX)  # dropped with the descriptor
                    yield descriptor
                finally:
                    os.close(descriptor)
        except (OSError, ValueError, TypeError) as error:
            raise self._unwritable(error) from error

    def _write(
        self, descriptor: int, event: str, *, who: str, valve: str, test: str, details: Mapping[str, Any] | None
    ) -> None:
        size, count, last = self._known_end(descriptor)
        entries = []
        fragment = os.pread(descriptor, _LONGEST, size)
        if fragment:
            held = {"bytes": os.fstat(descriptor).st_size - size, "text": fragment[:_SHOWN].decode(errors="replace")}
            entries.append(Entry(count + 1, _now(), TORN, "audit", "", "", held, last))
        previous = entries[-1].hash if entries else last
        entries.append(Entry(count + len(entries) + 1, _now(), event, who, valve, test, dict(details or {}), previous))
        data = b"".join(entry.line for entry in entries)
        if len(data) > _LONGEST:
            raise ValueError(f"an entry of {len(data)} bytes, the most is {_LONGEST}")
        if fragment:
            os.ftruncate(descriptor, size)
        written = os.write(descriptor, data)
        if written != len(data):
            raise OSError(errno.ENOSPC, f"{written} of {len(data)} bytes were written, the disk is full")
        os.fsync(descriptor)
        if count == 0:
            sync_folder(self.path.parent)  # the name of a new file
        self._end = (size + len(data), entries[-1].n, entries[-1].hash)

    def _known_end(self, descriptor: int) -> tuple[int, int, str]:
        """Bytes up to the end of the last whole line, and the count and the hash of the entry there."""
        size = os.fstat(descriptor).st_size
        if self._end is None or self._end[0] != size:
            self._end = _end_of(descriptor, size, self._start)
        return self._end

    def _unwritable(self, error: Exception) -> AuditError:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else message_of(error)
        return AuditError(
            say(
                "audit_log_not_written",
                "{file}: the audit log cannot be written ({why}), nothing moves without it: free disk space "
                "and make the folder writable; breakaway audit verify tells what stands in it",
                file=str(self.path),
                why=reason,
            )
        )


def _end_of(descriptor: int, size: int, start: str) -> tuple[int, int, str]:
    tail_at = max(0, size - 2 * _LONGEST)
    tail = os.pread(descriptor, size - tail_at, tail_at)
    whole, line_feed, _ = tail.rpartition(b"\n")
    if not line_feed:
        if tail_at:
            raise ValueError("its end is no entry")
        return 0, 0, start
    entry, stated = read_entry(whole.rpartition(b"\n")[2])
    if stated != entry.hash:
        raise ValueError("its last entry was changed")
    return tail_at + len(whole) + 1, entry.n, stated


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="microseconds")
