"""Who gets a core first in a benchmark whose parts stand for several machines."""

from __future__ import annotations

import contextlib
import ctypes
import os
from pathlib import Path
from typing import Final

DEVICES: Final = 2  # before the service, which has 1: they have processors of their own
CALLERS: Final = 1
_DROP_FROM_BOUNDING_SET, _SYS_NICE = 24, 23  # prctl(2), capabilities(7)


def as_elsewhere(pid: int, priority: int) -> None:
    """Let a process never wait for a core, where the system lets us: it stands for machines of their own."""
    with contextlib.suppress(PermissionError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(priority))


def refuse_precedence() -> None:
    """Let no program that is started from now on have real-time precedence; this one may still give it to them."""
    ctypes.CDLL(None).prctl(_DROP_FROM_BOUNDING_SET, _SYS_NICE, 0, 0, 0)  # without the right to it nobody had more
