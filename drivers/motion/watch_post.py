"""A bus that is watched is left at once for whoever takes it.

Whoever reads valves in service listens at a name beside the bus's lock. Whoever has taken the lock connects there,
waits for one byte, which says that the bus is free, and keeps the connection until the bus is given back. The watcher
stays away for as long. Where the taker dies the kernel ends its connection. One process at most watches a bus: a name
in the kernel can be had once, a socket in a folder belongs to whoever holds the lock file beside it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
from collections.abc import Awaitable, Callable, Iterator
from typing import Final

import structlog

from drivers.motion.local_socket import short_name
from valve.errors import BusyError
from valve.messages import say

_LOG = structlog.get_logger(__name__)
_LEFT: Final = b"."
_ASKING: Final = 16
_LOCK_SUFFIX: Final = ".lock"
_LISTEN_AGAIN_S: Final = 1.0


@contextlib.contextmanager
def _bindable(name: str) -> Iterator[str]:
    """Yield a name that a socket can have: one in a folder may be too long."""
    if name.startswith("\0"):
        yield name
        return
    with short_name(name) as address:
        yield address


def ask_to_leave(name: str, within_s: float, bus: str = "") -> socket.socket | None:
    """Ask whoever watches to leave, and wait until that is done. Blocks.

    Return the connection that keeps the watcher away until it is closed; None where nobody watches. One that does not
    leave ``within_s`` is not waited for.
    """
    asking: socket.socket | None = None
    try:
        asking = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        asking.settimeout(within_s)
        with _bindable(name) as address:
            asking.connect(address)
    except OSError:
        if asking is not None:
            asking.close()
        return None
    try:
        asking.recv(1)
    except OSError:  # it hangs: the bus is ours all the same
        _LOG.warning("who watches a bus did not leave it in time: end that process", bus=bus, seconds=within_s)
    return asking


def _locked(path: str) -> int:
    """Return the descriptor that holds a lock file until it is closed. Raises OSError (EWOULDBLOCK: it is held)."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


class WatchPost:
    """Where a watcher is asked to leave. Belongs to the event loop.

    ``leave`` is awaited when somebody takes the bus, and returns once nothing of ours is on it; ``on_free`` is called
    when nobody wants it any more.
    """

    def __init__(self, name: str, leave: Callable[[], Awaitable[None]], on_free: Callable[[], None]) -> None:
        self._name = name
        self._leave = leave
        self._on_free = on_free
        self._is_file = not name.startswith("\0")
        self._lock: int | None = None  # of the file beside a socket in a folder
        self._listener: socket.socket | None = None
        self._takers: set[asyncio.Task[None]] = set()

    @property
    def is_open(self) -> bool:
        """Whether somebody can ask."""
        return self._listener is not None

    @property
    def is_wanted(self) -> bool:
        """Whether somebody has the bus."""
        return bool(self._takers)

    async def open(self) -> None:
        """Listen. Raises BusyError where another process watches this bus, OSError."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.setblocking(False)
        try:
            if self._is_file:
                self._lock = _locked(f"{self._name}{_LOCK_SUFFIX}")
            with _bindable(self._name) as address:
                if self._is_file:
                    with contextlib.suppress(FileNotFoundError):
                        os.unlink(address)  # noqa: PTH108  - by its short name; a dead process left it
                listener.bind(address)
                if self._is_file:
                    os.chmod(address, 0o666)  # noqa: PTH101  - a socket by its short name; takers may be other users
            listener.listen(_ASKING)
        except OSError as error:
            listener.close()
            self._unlock()
            if error.errno in (errno.EADDRINUSE, errno.EWOULDBLOCK):
                raise BusyError(
                    say("bus_watched_elsewhere", "another process watches it: watch each valve from one plant file")
                ) from error
            raise
        self._listener = listener
        self._listen()

    def _listen(self) -> None:
        """Take whoever connects in the loop's own turn: what a task accepts is lost where it is cancelled."""
        if self._listener is not None:
            asyncio.get_running_loop().add_reader(self._listener, self._accept, self._listener)

    def _unlock(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    async def close(self) -> None:
        """Listen no more."""
        listener, self._listener = self._listener, None
        if listener is not None:
            asyncio.get_running_loop().remove_reader(listener)
            listener.close()
            for taker in tuple(self._takers):
                taker.cancel()
            await asyncio.gather(*self._takers, return_exceptions=True)
            if self._is_file:
                with contextlib.suppress(OSError), _bindable(self._name) as address:
                    os.unlink(address)  # noqa: PTH108  - by its short name
            self._unlock()

    def _accept(self, listener: socket.socket) -> None:
        try:
            taker, _ = listener.accept()
        except BlockingIOError:  # it went again
            return
        except OSError as error:  # this process has no descriptor left: whoever asks waits, and takes the bus anyway
            _LOG.error("nobody can ask to leave a bus for a while", exc_info=error)
            loop = asyncio.get_running_loop()
            loop.remove_reader(listener)
            loop.call_later(_LISTEN_AGAIN_S, self._listen)
            return
        taker.setblocking(False)
        staying = asyncio.ensure_future(self._stay_away(taker))
        self._takers.add(staying)
        staying.add_done_callback(lambda staying: self._gone(staying, taker))

    async def _stay_away(self, taker: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(OSError):
            await self._leave()
            await loop.sock_sendall(taker, _LEFT)
            while await loop.sock_recv(taker, 1):  # to its end: then the bus was given back, or its taker died
                pass

    def _gone(self, staying: asyncio.Task[None], taker: socket.socket) -> None:
        taker.close()
        self._takers.discard(staying)
        if not staying.cancelled() and (error := staying.exception()) is not None:
            _LOG.error("a bus was not left as asked", exc_info=error)
        if not self._takers:
            self._on_free()
