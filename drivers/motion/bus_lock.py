"""One owner a bus between processes: a name in the kernel by the bus's address, dropped by it when its holder dies.

The store's own lock keeps a second service off the same store; this one keeps a service with another store, or another
configuration that names the same line, off a bus that is in use. It holds on one machine, whoever runs the services:
the name is an abstract Unix socket, which no folder, account or temporary directory divides. Containers have names of
their own: there a folder that they share holds lock files instead. Between machines the fence of the device keeps them
apart (docs/reference-map.md).
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import hashlib
import ipaddress
import os
import socket
import struct
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress
from drivers.motion.watch_post import ask_to_leave
from valve.errors import BusyError, InternalError
from valve.messages import message_of, say

#: Names a folder for lock files instead, for containers; every service that may use the same buses must share it.
FOLDER_VARIABLE: Final = "BREAKAWAY_LOCK_FOLDER"
_ASKING: Final = 128  # processes that may ask who holds a bus before it is given back
_LONGEST_NUMBER: Final = 15  # digits of a process's number
_LOOKED_AT_S: Final = 0.01  # somebody who looks whether a lock file is locked holds it for less
_LEAVING_S: Final = 3.0  # beyond what one lost answer costs whoever watches: it may be at a TLS handshake of 2 s


def place_of(address: BusAddress) -> str:
    """Return where a bus really is, however a configuration names it."""
    if isinstance(address, (RtuAddress, GaugeAddress)):
        return os.path.realpath(address.serial_port)
    return f"{_one_spelling(address.host)}:{address.port}"


def _one_spelling(host: str) -> str:
    """Return a host by one of its spellings; a name is not looked up, as a plant is read where no network is, too."""
    name = host.lower().removesuffix(".")
    if name == "localhost":
        return "127.0.0.1"
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return name
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return str(mapped or address)


def watch_name(address: BusAddress) -> str:
    """Return where whoever watches a bus is asked to leave it (``drivers.motion.watch_post``)."""
    return _named("breakaway-watch", place_of(address), ".socket")


def is_taken(address: BusAddress) -> bool:
    """Whether some process, this one too, holds a bus; nothing is taken."""
    name = _named("breakaway-bus", place_of(address), ".lock")
    if name.startswith("\0"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
            asking.setblocking(False)
            try:
                asking.connect(name)
            except BlockingIOError:
                return True  # so many have asked
            except OSError:
                return False
            return True
    try:
        descriptor = os.open(name, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _leaving_s(address: BusAddress) -> float:
    """Longest time that whoever watches a bus may need to leave it, s: one transaction in flight, its answer lost."""
    slowest_s = address.worst_latency_s if isinstance(address, RtuAddress) else 0.0
    return 2.0 * max(slowest_s, address.timeout_s) + _LEAVING_S


@dataclass(frozen=True, slots=True)
class _Held:
    """A lock that is held, and the connection that keeps away who watches the bus; None where nobody does."""

    lock: int
    watcher: socket.socket | None

    def give_back(self) -> None:
        os.close(self.lock)  # first: who watches looks whether it is free
        if self.watcher is not None:
            self.watcher.close()


class BusLocks:
    """Locks of buses that this process holds, by name. Who watches a bus has left it when it is taken."""

    def __init__(self, addresses: Mapping[str, BusAddress]) -> None:
        self._addresses = addresses
        self._held: dict[str, _Held] = {}

    @property
    def held(self) -> frozenset[str]:
        """The buses that this process holds."""
        return frozenset(self._held)

    def take(self, buses: Iterable[str]) -> None:
        """Take all of them or none. Raises BusyError where another process has one."""
        taken: list[str] = []
        try:
            for bus in sorted(buses):
                if bus in self._addresses and bus not in self._held:
                    address = self._addresses[bus]
                    lock = _locked(bus, place_of(address))
                    self._held[bus] = _Held(lock, ask_to_leave(watch_name(address), _leaving_s(address), bus))
                    taken.append(bus)
        except BaseException:
            self.give_back(taken)
            raise

    async def take_aside(self, buses: Iterable[str]) -> None:
        """Do the same in a thread: a busy disk, or a folder on a network, must not hold up the valves that move.

        A caller that is cancelled meanwhile holds none.
        """
        wanted = [bus for bus in buses if bus not in self._held]
        taking = asyncio.ensure_future(asyncio.to_thread(self.take, wanted))
        try:
            await asyncio.shield(taking)
        except asyncio.CancelledError:
            taking.add_done_callback(lambda done: None if done.exception() else self.give_back(wanted))
            raise

    def give_back(self, buses: Iterable[str]) -> None:
        """Give them back; what is not held stays as it is."""
        for bus in buses:
            held = self._held.pop(bus, None)
            if held is not None:
                held.give_back()

    @asynccontextmanager
    async def hold(self, buses: Iterable[str]) -> AsyncIterator[None]:
        """Hold them for the length of the block. Raises BusyError."""
        wanted = [bus for bus in sorted(buses) if bus not in self._held]
        await self.take_aside(wanted)
        try:
            yield
        finally:
            self.give_back(wanted)


def _locked(bus: str, place: str) -> int:
    """Take a place; return the descriptor that holds it. Raises BusyError, InternalError."""
    name = _named("breakaway-bus", place, ".lock")
    return _name_taken(bus, place, name) if name.startswith("\0") else _file_locked(bus, place, Path(name))


def _named(kind: str, place: str, suffix: str) -> str:
    """Return the name of something at a place: one in the kernel, or with FOLDER_VARIABLE a path."""
    name = f"{kind}-{hashlib.sha256(place.encode()).hexdigest()[:24]}"
    folder = os.environ.get(FOLDER_VARIABLE)
    return str(Path(folder) / f"{name}{suffix}") if folder else f"\0{name}"


def _busy(bus: str, place: str, holder: str) -> BusyError:
    return BusyError(
        say(
            "bus_in_use",
            "bus {bus} ({place}) is used by another process (process {process}): wait for the end of its "
            "test, or stop it",
            bus=bus,
            place=place,
            process=holder or "unknown",
        )
    )


def _name_taken(bus: str, place: str, name: str) -> int:
    taken: socket.socket | None = None
    try:
        taken = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        taken.bind(name)
        taken.listen(_ASKING)  # who asks is told our process's number by the kernel; nobody is ever answered
    except OSError as error:
        if taken is not None:
            taken.close()
        if error.errno == errno.EADDRINUSE:
            raise _busy(bus, place, _holder(name)) from None
        raise InternalError(
            say(
                "bus_lock_not_taken",
                "bus {bus}: its lock cannot be taken ({why}), nothing moves without it: allow this service "
                "Unix sockets (RestrictAddressFamilies), or name a folder for lock files by {variable}",
                bus=bus,
                why=error.strerror or message_of(error),
                variable=FOLDER_VARIABLE,
            )
        ) from error
    return taken.detach()


def _holder(name: str) -> str:
    """Return the number of the process that holds a name; "" where the kernel does not tell it."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        asking.connect(name)
        process, _, _ = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        return str(process) if process else ""
    return ""


def _file_locked(bus: str, place: str, path: Path) -> int:
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise InternalError(
            say(
                "bus_lock_not_made",
                "bus {bus}: its lock {file} cannot be made ({why}), nothing moves without it: make the "
                "folder writable, or name another one by {variable} for every service that uses this bus",
                bus=bus,
                file=str(path),
                why=error.strerror or message_of(error),
                variable=FOLDER_VARIABLE,
            )
        ) from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOOKED_AT_S)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, _LONGEST_NUMBER, 0).decode(errors="replace").strip()
        os.close(descriptor)
        raise _busy(bus, place, holder) from None
    # Of one length, and only where it is new: to truncate it on a busy disk took 0.13 s, in which no valve was sampled.
    own = f"{os.getpid():<{_LONGEST_NUMBER}}\n".encode()
    if os.pread(descriptor, len(own), 0) != own:
        os.pwrite(descriptor, own, 0)
    return descriptor
