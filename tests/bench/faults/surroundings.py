"""What stands around a valve's own wire, and dies at a word: buses of contacts and gauge, the disk, the database."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import subprocess
import tempfile
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from functools import cache
from pathlib import Path
from typing import Final, TypeVar

import psycopg
from sqlalchemy import make_url

from drivers.maps import register_map
from service.store.database import open_database
from simulator.assembly import SimulatedChannel, SimulatedPlant, SimulatedUnit
from simulator.faults import Fault, FaultKind
from simulator.unit import Quantity
from tests.bench.faults.wire_faults import PlantFault
from tests.support.databases import SERVER, why_no_server
from tests.support.slave import RawSlave, TcpPort

_T = TypeVar("_T")
_MAKING: Final = threading.Lock()  # of the database that the others are made from
#: Longest time from a fault of these to the end of the motion: a permissive's second, a window of 2 s, a slow machine.
HEEDED_S: Final = 4.0
# A disk that is full still takes what the last page of the journal has room for: 4 KiB, some seconds of samples.
LAST_PAGE_S: Final = 3.0
#: A test that was driven for longer after a fault that must end it may not be completed.
TOLD_S: Final = 2.5
#: From a fault behind which Stop is pressed to the end of the motion, on a busy machine: shorter than the watchdog of
#: such a case. How quick it is on a quiet one the benchmark `stop_service` says.
STOPPED_S: Final = 2.5
#: Those by which every test must end, however little of it is left.
ENDING: Final = frozenset({PlantFault.DEAD_CONTACTS, PlantFault.DEAD_GAUGE, PlantFault.FLAPPING})
_FLAPS: Final = 200
_FLAP_S: Final = 0.04  # as often as the position is looked at: no two looks in a row are wrong in one way
_JUMP_M: Final = 0.2
_DISK_BYTES: Final = 256 << 20  # a test wants 200 MB free before it moves; memory is taken only by the filling
_CONTACT_UNIT: Final = 9
_GAUGE_UNIT: Final = 2
GAUGE_HOST: Final = "127.0.0.2"  # of the loopback too: a listener of its own beside the valve's
GAUGE_MAP: Final = "moxa_iologik_e1240"
GAUGE_REGISTER: Final = "ai0_raw"


class Tunnel:
    """A TCP port that carries bytes to another one until it goes dark: then nothing passes, and no connection ends."""

    def __init__(self, host: str, port: int) -> None:
        self._upstream = host, port
        self._lit = asyncio.Event()
        self._lit.set()
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> int:
        """Return the port that it listens on."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Cut everything."""
        assert self._server is not None
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def go_dark(self) -> None:
        """Carry nothing more."""
        self._lit.clear()

    def light_up(self) -> None:
        """Carry again what comes, and what was held back."""
        self._lit.set()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        with contextlib.suppress(OSError):
            other_reader, other_writer = await asyncio.open_connection(*self._upstream)
            try:
                async with asyncio.TaskGroup() as both:
                    both.create_task(self._carry(reader, other_writer))
                    both.create_task(self._carry(other_reader, writer))
            except* OSError:
                pass
            finally:
                other_writer.close()
        self._tasks.discard(task)
        writer.close()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            await self._lit.wait()
            writer.write(data)
            await writer.drain()
        writer.close()


@asynccontextmanager
async def _tunnel(port: int, host: str = "127.0.0.1") -> AsyncIterator[tuple[Tunnel, int]]:
    tunnel = Tunnel(host, port)
    ours = await tunnel.start()
    try:
        yield tunnel, ours
    finally:
        await tunnel.stop()


def _bus_text(name: str, port: int) -> str:
    return f'[[buses]]\nname = "{name}"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_s = 0.25\n'


def gauge_unit(tag: str, span_m: tuple[float, float]) -> SimulatedUnit:
    """Return a second device that shows the valve's position alone."""
    shown = register_map(GAUGE_MAP).register(GAUGE_REGISTER).spanning((0.0, 1.0), span_m, "m")
    return SimulatedUnit(_GAUGE_UNIT, register_map(GAUGE_MAP), (SimulatedChannel(tag, Quantity.POSITION, shown),))


def gauge_text(span_m: tuple[float, float]) -> str:
    """Return where plant.toml finds that position."""
    return (
        f'[valves.position]\nbus = "gauge"\ndevice_id = {_GAUGE_UNIT}\nmap = "{GAUGE_MAP}"\n'
        f'register = "{GAUGE_REGISTER}"\nsignal = [0.0, 1.0]\nquantity = {list(span_m)}\n'
    )


class Surroundings:
    """What one case has beside its valve's own wire; ``strike`` does its fault, and the texts go into plant.toml."""

    def __init__(self, fault: PlantFault | None, tag: str) -> None:
        self.fault = fault
        self.buses = self.permissives = ""
        self.database = ""
        self.plant: SimulatedPlant | None = None
        self._tag = tag
        self._tunnel: Tunnel | None = None
        self._disk: Path | None = None
        self._at_disk: asyncio.Future[None] | None = None

    async def set_up(self, stack: AsyncExitStack, folder: Path) -> None:
        """Make what the fault needs, the plant being served; it is taken away as the stack is closed."""
        match self.fault:
            case PlantFault.DEAD_CONTACTS:
                port = (await stack.enter_async_context(TcpPort(_contacts()))).port
                self._tunnel, ours = await stack.enter_async_context(_tunnel(port))
                self.buses = _bus_text("contacts", ours)
                self.permissives = _contact_text("manual", "ai2") + _contact_text("interlock", "ai3")
            case PlantFault.DEAD_GAUGE:
                assert self.plant is not None
                port = int(self.plant.addresses[-1].rpartition(":")[2])
                self._tunnel, ours = await stack.enter_async_context(_tunnel(port, GAUGE_HOST))
                self.buses = _bus_text("gauge", ours)
            case PlantFault.FULL_DISK:
                self._disk = await _aside(stack, _small_disk(folder / "store"))
            case PlantFault.DARK_DATABASE:
                name = await _aside(stack, _database())
                server = make_url(SERVER)
                self._tunnel, ours = await stack.enter_async_context(_tunnel(server.port or 5432))
                self.database = f"postgresql+psycopg://{server.username}@127.0.0.1:{ours}/{name}"
            case _:
                pass

    def strike(self) -> None:
        """Do the fault."""
        match self.fault:
            case PlantFault.DEAD_CONTACTS | PlantFault.DEAD_GAUGE | PlantFault.DARK_DATABASE:
                assert self._tunnel is not None
                self._tunnel.go_dark()
            case PlantFault.FULL_DISK:
                assert self._disk is not None
                self._at_disk = asyncio.get_running_loop().run_in_executor(None, _fill, self._disk)
            case PlantFault.FLAPPING:
                self._inject(*_flaps(self._now_s))
            case PlantFault.STUCK_STEM:
                self._inject(Fault(FaultKind.STUCK_STEM, self._now_s))
            case None:
                pass

    async def mend(self) -> None:
        """Take away what would keep a restart from telling what happened."""
        if self._tunnel is not None:
            self._tunnel.light_up()
        if self._disk is not None and self._at_disk is not None:
            await self._at_disk
            await asyncio.to_thread(_resize, self._disk, _DISK_BYTES)
            self._at_disk = None

    @property
    def _now_s(self) -> float:
        assert self.plant is not None
        return self.plant.clock.now_s() + 0.001

    def _inject(self, *faults: Fault) -> None:
        assert self.plant is not None
        for fault in faults:
            self.plant.inject(self._tag, fault)


async def _aside(stack: AsyncExitStack, context: AbstractContextManager[_T]) -> _T:
    """Enter a context in a thread, and leave it in one: the other cases of this process go on meanwhile."""
    made = await asyncio.to_thread(context.__enter__)
    stack.push_async_callback(asyncio.to_thread, context.__exit__, None, None, None)
    return made


def _flaps(start_s: float) -> Iterator[Fault]:
    """Invalid, then beyond its limits, then invalid again."""
    for number in range(_FLAPS):
        at_s = start_s + 2.0 * number * _FLAP_S
        yield Fault(FaultKind.SENSOR_LOST, at_s, at_s + _FLAP_S)
        yield Fault(FaultKind.SENSOR_JUMP, at_s + _FLAP_S, at_s + 2.0 * _FLAP_S, _JUMP_M)


def _contacts() -> RawSlave:
    """Return a module whose third input says that the loop is in manual, and whose fourth says no interlock."""
    slave = RawSlave()
    for address in range(32):
        slave.holding[_CONTACT_UNIT, address] = 0
    slave.holding[_CONTACT_UNIT, 2], slave.holding[_CONTACT_UNIT, 3] = 12_000, 3_000  # 6.9 and 4.7 mA
    return slave


def _contact_text(name: str, register: str) -> str:
    return (
        f'[valves.permissives.{name}]\nbus = "contacts"\ndevice_id = {_CONTACT_UNIT}\nmap = "advantech_adam_6024"\n'
        f'register = "{register}"\nabove = 0.006\n'
    )


# ---- a disk that is full


@cache
def why_no_disk() -> str:
    """Return why no small disk of its own can be had; "" where one can."""
    if os.geteuid() != 0:
        return "only root may mount a small disk"
    with contextlib.suppress(OSError, subprocess.CalledProcessError), contextlib.ExitStack() as stack:
        stack.enter_context(_small_disk(Path(stack.enter_context(tempfile.TemporaryDirectory()))))
        return ""
    return "this machine mounts no small disk"


@contextmanager
def _small_disk(folder: Path) -> Iterator[Path]:
    folder.mkdir(exist_ok=True)
    options = f"size={_DISK_BYTES},mode=0700"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "breakaway-bench", folder], check=True, capture_output=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True, capture_output=True)


def _fill(folder: Path) -> None:
    """Leave the disk no larger than what is on it: full at once, and without a writer that takes the machine's time."""
    while True:
        disk = os.statvfs(folder)
        with contextlib.suppress(subprocess.CalledProcessError):  # somebody has written meanwhile
            _resize(folder, (disk.f_blocks - disk.f_bfree) * disk.f_frsize)
            return


def _resize(folder: Path, size: int) -> None:
    subprocess.run(["mount", "-o", f"remount,size={size}", folder], check=True, capture_output=True)


# ---- a database of its own, from one that has the tables already


@cache
def _template_database() -> str:
    name = f"breakaway_faults_{secrets.token_hex(6)}"
    _on_server(f'CREATE DATABASE "{name}" TEMPLATE template0')
    open_database(f"{SERVER.replace('postgresql://', 'postgresql+psycopg://')}/{name}").dispose()
    return name


@contextmanager
def _database() -> Iterator[str]:
    name = f"breakaway_fault_{secrets.token_hex(6)}"
    with _MAKING:
        template = _template_database()
    _on_server(f'CREATE DATABASE "{name}" TEMPLATE "{template}"')
    try:
        yield name
    finally:
        _on_server(f'DROP DATABASE "{name}" WITH (FORCE)')


def drop_template() -> None:
    """Drop the database that the others were made from, where one was."""
    if _template_database.cache_info().currsize:
        _on_server(f'DROP DATABASE "{_template_database()}" WITH (FORCE)')
        _template_database.cache_clear()


def _on_server(statement: str) -> None:
    with psycopg.connect(f"{SERVER}/postgres", autocommit=True) as connection:
        connection.execute(statement)


def why_not(fault: object) -> str:
    """Return why this machine cannot have a fault; "" where it can."""
    if fault is PlantFault.FULL_DISK:
        return why_no_disk()
    if fault is PlantFault.DARK_DATABASE:
        return why_no_server()
    return ""
