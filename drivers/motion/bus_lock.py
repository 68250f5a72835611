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
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress
from valve.errors import BusyError, InternalError

#: Names a folder for lock files instead, for containers; every service that may use the same buses must share it.
FOLDER_VARIABLE: Final = "BREAKAWAY_LOCK_FOLDER"
_ASKING: Final = 128  # processes that may ask who holds a bus before it is given back
_LONGEST_NUMBER: Final = 15  # digits of a process's number


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


class BusLocks:
    """Locks of buses that this process holds, by name."""

    def __init__(self, addresses: Mapping[str, BusAddress]) -> None:
        self._addresses = addresses
        self._held: dict[str, int] = {}

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
                    self._held[bus] = _locked(bus, place_of(self._addresses[bus]))
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
            descriptor = self._held.pop(bus, None)
            if descriptor is not None:
                os.close(descriptor)

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
    name = f"breakaway-bus-{hashlib.sha256(place.encode()).hexdigest()[:24]}"
    folder = os.environ.get(FOLDER_VARIABLE)
    return _file_locked(bus, place, Path(folder) / f"{name}.lock") if folder else _name_taken(bus, place, f"\0{name}")


def _busy(bus: str, place: str, holder: str) -> BusyError:
    return BusyError(
        f"bus {bus} ({place}) is used by another process (process {holder or 'unknown'}): wait for the end of its "
        "test, or stop it"
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
            f"bus {bus}: its lock cannot be taken ({error.strerror}), nothing moves without it: allow this service "
            f"Unix sockets (RestrictAddressFamilies), or name a folder for lock files by {FOLDER_VARIABLE}"
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
            f"bus {bus}: its lock {path} cannot be made ({error.strerror}), nothing moves without it: make the folder "
            f"writable, or name another one by {FOLDER_VARIABLE} for every service that uses this bus"
        ) from error
    try:
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
