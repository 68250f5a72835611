"""Time by the clock, less what a busy machine took: a promise of ours is judged by what was ours to keep."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

_THREADS = Path("/proc/self/task")


def _waited_for_a_core_s() -> float:
    """Return how long this process' threads were ready to run and had no core, s; 0 where the system does not tell."""
    waited_ns = 0
    with contextlib.suppress(OSError):  # no such account, or a thread that ended meanwhile
        for thread in _THREADS.iterdir():
            with contextlib.suppress(OSError, IndexError, ValueError):
                waited_ns += int((thread / "schedstat").read_text(encoding="ascii").split()[1])
    return 1.0e-9 * waited_ns


class Stopwatch:
    """Runs from when it is made."""

    def __init__(self) -> None:
        self._began_s, self._waited_s = time.monotonic(), _waited_for_a_core_s()

    @property
    def own_s(self) -> float:
        """Seconds since then in which this process ran, or waited for anything but a core."""
        passed_s = time.monotonic() - self._began_s
        return max(0.0, passed_s - max(0.0, _waited_for_a_core_s() - self._waited_s))
