"""How long a worker process may take: by its processor time, which other work on the machine does not use up."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

# Own choice: beside a plant's tests, which go before it, a worker still gets a sixth of a core; else it hangs.
_PATIENCE: Final = 6.0
_USER_TICKS, _SYSTEM_TICKS = 11, 12  # proc(5): utime and stime, counted from the state behind the name


class Allowance:
    """What a process may still use: ``limit_s`` of processor time, and six times as long by the clock.

    Where the system does not tell the processor time of a process, the clock alone counts, up to ``limit_s``.
    """

    def __init__(self, pid: int, limit_s: float) -> None:
        self._pid = pid
        self._limit_s = limit_s
        self._began_s = time.monotonic()
        self._used_s = processor_time_s(pid)

    def left_s(self) -> float:
        """Seconds that may go by before it is worth asking again; 0 or less once the process took too long."""
        passed_s, used_s = time.monotonic() - self._began_s, processor_time_s(self._pid)
        if used_s is None or self._used_s is None:
            return self._limit_s - passed_s
        return min(self._limit_s - (used_s - self._used_s), _PATIENCE * self._limit_s - passed_s)


def processor_time_s(pid: int) -> float | None:
    """Processor time of a process, s; None where it has ended or the system is no Linux."""
    with suppress(OSError, ValueError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return (int(fields[_USER_TICKS]) + int(fields[_SYSTEM_TICKS])) / os.sysconf("SC_CLK_TCK")
    return None
