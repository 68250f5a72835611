"""The program that moves valves, as a process: started, told to end, and ended with every valve safe."""

from __future__ import annotations

import asyncio
import gc
import resource
import signal
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import structlog

from drivers.addresses import BusAddress, ValveWiring
from drivers.motion.audit_log import AuditLog
from drivers.motion.bus_lock import BusLocks
from drivers.motion.local_socket import LONGEST_LINE, listening
from drivers.motion.motion import Motion
from drivers.motion.precedence import Precedence
from drivers.motion.rig import WiredRig
from drivers.motion.server import MotionServer
from drivers.motion.service_manager import ServiceManager
from drivers.motion.spool import Spool
from drivers.motion.watching import Watching
from valve.messages import say

_LOG = structlog.get_logger(__name__)
# A closed terminal, and Ctrl-\, too: each would end the process at once, and leave a valve where it stands.
_ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_END_S: Final = 20.0
# Threads write journals; by default (5 ms) each may keep the polling waiting for so long before it hands on.
_THREAD_TURN_S: Final = 0.5e-3
_TIDY_S: Final = 10.0
_FILES_WANTED: Final = 65536
_UNREAD_S: Final = 5.0
_WATCHED_AFTER_S: Final = 3.0  # behind the longest watchdog: until then the device of a valve that was left may act


@dataclass(frozen=True, slots=True)
class Moved:
    """What a plant file says of what moves: its buses by name, and its valves by tag."""

    buses: Mapping[str, BusAddress]
    wirings: Mapping[str, ValveWiring]


@dataclass(frozen=True, slots=True)
class Place:
    """Where the program works: its socket, its folders, and the gateway's name.

    The folders are those of the journals, of the audit log, and of what is read of valves in service.
    """

    socket: Path
    journals: Path
    audit: Path
    watched: Path
    gateway: str

    @classmethod
    def in_store(cls, store: Path, socket: Path, gateway: str) -> Place:
        """Return the places in the folder of a store."""
        return cls(socket, store / "journals", store / "audit", store / "watched", gateway)


class FilePlant:
    """What moves, as the file says it; a bus that is known stays where it is until the next start."""

    def __init__(self, read: Callable[[], Moved]) -> None:
        self.read = read
        self._read_last = moved = read()
        self.buses = dict(moved.buses)
        self.wirings: Mapping[str, ValveWiring] = moved.wirings

    def take(self, fresh: Moved, kept: frozenset[str]) -> None:
        """Become what was read, but for the ``kept`` valves."""
        self._read_last = fresh
        self.buses.update({name: one for name, one in fresh.buses.items() if name not in self.buses})
        stay = {tag: wiring for tag, wiring in self.wirings.items() if tag in kept}
        self.wirings = {**fresh.wirings, **stay}

    def settle(self, tag: str) -> None:
        """Let a valve that was kept become what was read last."""
        fresh = {one: wiring for one, wiring in self._read_last.wirings.items() if one == tag}
        self.wirings = {**{one: wiring for one, wiring in self.wirings.items() if one != tag}, **fresh}


def run(read: Callable[[], Moved], place: Place, software: str) -> None:
    """Serve until a signal ends it; then every valve is sent to its safe value. ``read`` reads the plant file.

    Raises ConfigurationError where the file, the socket or the audit log is wrong.
    """
    sys.setswitchinterval(_THREAD_TURN_S)
    _provide_files()
    place.journals.mkdir(parents=True, exist_ok=True)
    Spool(place.journals).tidy()
    plant = FilePlant(read)
    precedence = Precedence()
    motion = Motion(
        plant,
        WiredRig(plant.buses, software, precedence.motion),
        place.journals,
        locks=BusLocks(plant.buses),
        audit=AuditLog(place.audit, place.gateway or "gateway"),
    )

    def watched_after_s() -> float:
        return max((one.watchdog.timeout_s or 0.0 for one in plant.wirings.values()), default=0.0) + _WATCHED_AFTER_S

    motion.watching = Watching(plant, plant.buses, place.watched, software, after_s=watched_after_s)
    precedence.try_once()
    asyncio.run(_serve(motion, motion.watching, place, software, precedence))


async def _serve(motion: Motion, watching: Watching, place: Place, software: str, precedence: Precedence) -> None:
    ending = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in _ENDING_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup asks for it
            loop.add_signal_handler(number, _end, motion, ending)
    server, manager = MotionServer(motion, software, precedence), ServiceManager()
    with listening(place.socket) as listener:
        listener.setblocking(False)
        listens = await asyncio.start_unix_server(server.accept, sock=listener, limit=LONGEST_LINE)
        beside = [asyncio.create_task(manager.keep_alive()), asyncio.create_task(_tidy_at_rest(motion))]
        reading = asyncio.create_task(watching.run())
        _settle_memory()
        manager.say("READY=1")
        _LOG.info("motion process listening", socket=str(place.socket), valves=len(motion.tags))
        try:
            await ending.wait()
            manager.say("STOPPING=1")
            await motion.shut_down(_STOPPED, _END_S)
            await server.close()
        finally:
            for task in (*beside, reading):
                task.cancel()
            await asyncio.wait({reading}, timeout=_UNREAD_S)  # what was read goes to the disk
            listens.close()
            precedence.close()
            place.socket.unlink(missing_ok=True)
    _LOG.info("motion process ended")


_STOPPED: Final = say("stopped_motion_shut_down", "stopped: the motion process was shut down")


def _end(motion: Motion, ending: asyncio.Event) -> None:
    motion.begin_shutdown(_STOPPED)
    ending.set()


def _provide_files() -> None:
    """Raise the limit of open files as far as the system allows: a watched valve has one, and no test may lack its."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _FILES_WANTED if hard == resource.RLIM_INFINITY else min(hard, _FILES_WANTED)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _settle_memory() -> None:
    """Leave what stays for ever out of the garbage collector's rounds, and have none begin by itself."""
    gc.collect()
    gc.freeze()
    gc.disable()


async def _tidy_at_rest(motion: Motion) -> None:
    """Make full rounds of the garbage collector while nothing moves, and short ones else: young things die young."""
    while True:
        await asyncio.sleep(_TIDY_S)
        gc.collect(0 if motion.moves else 2)
