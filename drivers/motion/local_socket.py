"""The local socket of the program that moves valves: where it is, and how both ends open it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from valve.errors import ConfigurationError
from valve.messages import message_of, say

NAME: Final = "motion.sock"
LONGEST_LINE: Final = 64 * 1024 * 1024  # a test of 300 s at 1 kHz is fetched in blocks of a fraction of that
_LONGEST_PATH: Final = 100  # bytes that every system takes as the name of a socket


@contextlib.contextmanager
def short_name(path: Path | str) -> Iterator[str]:
    """Yield a name of the socket that is short enough, whatever its folder is called."""
    path = Path(path)
    if len(os.fsencode(path)) <= _LONGEST_PATH:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


def listening(path: Path) -> socket.socket:
    """Return a socket that listens at ``path`` for this user alone. Raises ConfigurationError.

    One that a dead process left is replaced; one that is answered at is another process'.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with short_name(path) as address:
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
                asking.connect(address)
                raise ConfigurationError(
                    say(
                        "motion_process_there",
                        "{socket}: a motion process answers there already: end it, or use that one",
                        socket=str(path),
                    )
                )
            path.unlink(missing_ok=True)
            former = os.umask(0o177)
            try:
                listener.bind(address)
            finally:
                os.umask(former)
        listener.listen()
    except OSError as error:
        listener.close()
        raise ConfigurationError(
            say(
                "socket_cannot_listen",
                "{socket}: the motion process cannot listen there ({why}): make its folder writable",
                socket=str(path),
                why=error.strerror or message_of(error),
            )
        ) from error
    except BaseException:
        listener.close()
        raise
    return listener


async def connected(path: Path) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Return a connection to whoever listens at ``path``. Raises OSError."""
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.setblocking(False)
    try:
        with short_name(path) as address:
            await asyncio.get_running_loop().sock_connect(line, address)
        return await asyncio.open_unix_connection(sock=line, limit=LONGEST_LINE)
    except BaseException:
        line.close()
        raise
