"""One owner a bus between processes: a lock file by the bus's address, dropped by the system when its holder dies.

The store's own lock keeps a second service off the same store; this one keeps a service with another store, or another
configuration that names the same line, off a bus that is in use. It holds on one machine: between machines the fence
of the device does (docs/reference-map.md).
"""

from __future__ import annotations

import fcntl
import hashlib
import ipaddress
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
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
    """Return the folder of the lock files: as the environment says, or the machine's one for temporary files."""
    return Path(os.environ.get(FOLDER_VARIABLE) or tempfile.gettempdir())


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

    def give_back(self, buses: Iterable[str]) -> None:
        """Give them back; what is not held stays as it is."""
        for bus in buses:
            descriptor = self._held.pop(bus, None)
            if descriptor is not None:
                os.close(descriptor)

    @contextmanager
    def hold(self, buses: Iterable[str]) -> Iterator[None]:
        """Hold them for the length of the block. Raises BusyError."""
        wanted = [bus for bus in sorted(buses) if bus not in self._held]
        self.take(wanted)
        try:
            yield
        finally:
            self.give_back(wanted)


def _locked(bus: str, place: str) -> int:
    path = lock_folder() / f"breakaway-bus-{hashlib.sha256(place.encode()).hexdigest()[:24]}.lock"
    try:
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
