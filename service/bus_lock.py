"""One owner a bus between processes: a lock file by the bus's address, dropped by the system when its holder dies.

The store's own lock keeps a second service off the same store; this one keeps a service with another store, or another
configuration that names the same line, off a bus that is in use. It holds on one machine: between machines the fence
of the device does (docs/reference-map.md). Services of several users see each other only where the environment names
one folder for all of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import hashlib
import ipaddress
import os
import stat
import tempfile
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress
from valve.errors import BusyError, InternalError

#: Names another folder for the lock files; every service of a machine must use the same.
FOLDER_VARIABLE: Final = "BREAKAWAY_LOCK_FOLDER"
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


def lock_folder() -> Path:
    """Return the folder of the lock files: as the environment says, or one for this user alone, made where it is not.

    The latter goes by the user alone: one that a login or a service manager gives would not be the same for both.
    Raises InternalError where somebody else made it, or may write there: what lies in it proves nothing then.
    """
    named = os.environ.get(FOLDER_VARIABLE)
    if named:
        return Path(named)
    folder = Path(tempfile.gettempdir()) / f"breakaway-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise InternalError(
            f"{folder}: the folder of the bus locks is not this user's alone (owner {found.st_uid}, mode "
            f"{stat.S_IMODE(found.st_mode):o}), nothing moves without it: remove it, or name another folder for every "
            f"service of this machine by {FOLDER_VARIABLE}"
        )
    return folder


class BusLocks:
    """Locks of buses that this process holds, by name."""

    def __init__(self, addresses: Mapping[str, BusAddress]) -> None:
        self._addresses = addresses
        self._held: dict[str, int] = {}

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
    name = f"breakaway-bus-{hashlib.sha256(place.encode()).hexdigest()[:24]}.lock"
    path = Path(name)
    try:
        path = lock_folder() / name
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    except OSError as error:
        raise InternalError(
            f"bus {bus}: its lock {path} cannot be made ({error.strerror}), nothing moves without it: make the folder "
            f"writable, or name another one for every service of this machine by {FOLDER_VARIABLE}"
        ) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, _LONGEST_NUMBER, 0).decode(errors="replace").strip()
        os.close(descriptor)
        raise BusyError(
            f"bus {bus} ({place}) is used by another process (process {holder or 'unknown'}): wait for the end of its "
            "test, or stop it"
        ) from None
    # Of one length, and only where it is new: to truncate it on a busy disk took 0.13 s, in which no valve was sampled.
    own = f"{os.getpid():<{_LONGEST_NUMBER}}\n".encode()
    if os.pread(descriptor, len(own), 0) != own:
        os.pwrite(descriptor, own, 0)
    return descriptor
