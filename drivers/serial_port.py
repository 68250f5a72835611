"""Why a serial port cannot be opened, and who has it where the system tells."""

from __future__ import annotations

import errno
import os
import termios
from pathlib import Path
from typing import Final

import serial

from valve.messages import message_of, say

_PROC: Final = Path("/proc")
_HELD: Final = (errno.EBUSY, errno.EAGAIN)  # opened for one alone (TIOCEXCL), or locked


def refusal_of(port: str) -> OSError | None:
    """Open a port once more, and return what refuses it; None where nothing does."""
    try:
        serial.Serial(port, exclusive=True).close()
    except termios.error as error:
        return OSError(*error.args)
    except OSError as error:  # what pyserial raises is one
        return error
    return None


def why_not_opened(port: str, error: Exception | None) -> str:
    """Return the reason and what to do about it. It looks through /proc where somebody else has the port."""
    number = error.errno if isinstance(error, OSError) else None
    if number in _HELD:
        return say(
            "port_in_use",
            "it is in use by {holder}: end that, or name another port",
            holder=_holder(port) or say("another_program", "another program"),
        )
    if number == errno.ENOENT:
        return say("no_such_port", "there is no such port: check serial_port, and that the adapter is plugged in")
    if number in (errno.EACCES, errno.EPERM):
        return say(
            "port_not_allowed", "this account may not use it: add the account to the port's group (dialout, as a rule)"
        )
    return (
        say("check_port_settings", "check the port and its settings ({why})", why=message_of(error))
        if error is not None
        else say("check_port_and_line", "check the port and the line")
    )


def _holder(port: str) -> str:
    """Return the process that has the port, in words; "" where the system does not tell this account."""
    path = Path(os.path.realpath(port))
    own = os.getpid()
    processes = sorted(_locking(path) or _opening(path), key=lambda process: process == own)
    if not processes:
        return ""
    if processes[0] == own:
        return say("this_process", "this process ({process}) itself", process=own)
    try:
        return say(
            "process_named",
            "process {processes_low} ({strip})",
            processes_low=processes[0],
            strip=(_PROC / str(processes[0]) / "comm").read_text().strip(),
        )
    except OSError:
        return say("process", "process {processes_low}", processes_low=processes[0])


def _locking(path: Path) -> list[int]:
    """Processes that lock it: one file tells of every account's."""
    try:
        device = path.stat()
        lines = [line.split() for line in (_PROC / "locks").read_text().splitlines()]
    except OSError:
        return []
    # A line: 1: FLOCK ADVISORY WRITE 9244 00:1b:2297 0 EOF
    place = f"{os.major(device.st_dev):02x}:{os.minor(device.st_dev):02x}:{device.st_ino}"
    return [int(line[4]) for line in lines if len(line) > 5 and line[5] == place and int(line[4]) > 0]


def _opening(path: Path) -> list[int]:
    """Processes of this account that have it open."""
    found = []
    for folder in _PROC.iterdir():
        try:
            if folder.name.isdigit() and any(one.readlink() == path for one in (folder / "fd").iterdir()):
                found.append(int(folder.name))
        except OSError:
            continue  # it has ended, or is another account's
    return found
