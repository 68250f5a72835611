"""Processor time that processes have used, by the system's own account (proc(5))."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

_TICK_S: Final = 1.0 / os.sysconf("SC_CLK_TCK")
_PARENT, _USER, _CHILDREN_SYSTEM = 1, 11, 14  # fields after the name, in which anything may stand


def used_by_role_s(service: int, motion: int, devices: int) -> dict[str, float]:
    """Return the processor time, s, of the service, of what moves its valves, of its analyses, and of the devices."""
    own = {"service": _own_s(service), "motion": _own_s(motion)}
    return {**own, "analyses": _children_s(service), "devices": _own_s(devices)}


def machine_used_s() -> float:
    """Return the processor time that all cores were busy, s, since the machine started."""
    first = Path("/proc/stat").read_text(encoding="ascii").partition("\n")[0].split()
    user, nice, system, _idle, _iowait, interrupts, soft_interrupts = (int(ticks) for ticks in first[1:8])
    return (user + nice + system + interrupts + soft_interrupts) * _TICK_S


def _fields(process: Path) -> list[str]:
    return (process / "stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()


def _own_s(pid: int) -> float:
    fields = _fields(Path(f"/proc/{pid}"))
    return (int(fields[_USER]) + int(fields[_USER + 1])) * _TICK_S


def _children_s(pid: int) -> float:
    """Return the processor time of a process' children, those that have ended among them."""
    ended = _fields(Path(f"/proc/{pid}"))[_CHILDREN_SYSTEM - 1 : _CHILDREN_SYSTEM + 1]
    ticks = sum(int(one) for one in ended)
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            fields = _fields(process)
            if int(fields[_PARENT]) == pid:
                ticks += int(fields[_USER]) + int(fields[_USER + 1])
    return ticks * _TICK_S
