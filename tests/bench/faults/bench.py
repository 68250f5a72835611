"""One case: a station, what moves its valve and a service, each in a process, a fault at one transaction, a verdict."""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import cache
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from drivers.motion.local_socket import NAME
from service.store.store import Store
from tests.bench.faults import victim
from tests.bench.faults.judge import Verdict, judge, told_by
from tests.bench.faults.station import LONG_ORDER, ORDER, WATCHDOG_S, Carrier, Mode, Station, station
from tests.bench.faults.wire_faults import FaultAt, PlantFault, ServiceFault

_PATIENCE_S: Final = 60.0
_END_S: Final = 10.0
_STOP_AFTER_S: Final = 0.1  # from a database that answers no more to a stop
_OF_SERVICE: Final = {
    ServiceFault.KILL_BOTH: signal.SIGKILL,
    ServiceFault.KILL_SERVICE: signal.SIGKILL,
    ServiceFault.TERM_SERVICE: signal.SIGTERM,
    ServiceFault.IDLE_SESSION: signal.SIGUSR2,
}
_OF_MOTION: Final = {
    ServiceFault.KILL_BOTH: signal.SIGKILL,
    ServiceFault.KILL_MOTION: signal.SIGKILL,
    ServiceFault.TERM: signal.SIGTERM,
    ServiceFault.HANG_UP: signal.SIGHUP,
}
_MOTION_BACK_S: Final = 2.5 * WATCHDOG_S  # a motion process that was killed is started again, as a unit is
_DARK_PATIENCE_S: Final = 12.0  # a service whose database answers no more may hang when its valve is safe
_ATTEMPTS: Final = 5
_CONTEXT: Final = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.bench.faults.victim"])


@dataclass(frozen=True, slots=True)
class Case:
    """One fault on one carrier."""

    carrier: Carrier
    mode: Mode
    fault: FaultAt | None
    order: Mapping[str, Any] | None = None


@cache
def _template() -> Path:
    """A store that is made already: its migrations take longer than a test."""
    folder = Path(tempfile.mkdtemp(prefix="breakaway-faults-"))
    Store(folder / "store").close()
    return folder / "store"


async def run_case(case: Case, folder: Path) -> tuple[Verdict, int]:
    """Run a case in an empty folder; the verdict and how many transactions the test had.

    A test that was refused before its fault came, as a machine without a core to spare opens no bus in time, says
    nothing of the fault: it is run again, a few times.
    """
    attempt = 0
    while True:
        attempt += 1
        place = folder / f"attempt-{attempt}"
        place.mkdir()
        verdict, transactions = await _run_once(case, place)
        untried = verdict.outcome == "refused" and verdict.good and not struck(case, transactions)
        if not untried or attempt == _ATTEMPTS:
            return verdict, transactions


def struck(case: Case, transactions: int) -> bool:
    """Whether a test of so many transactions met its fault."""
    return case.fault is not None and transactions > case.fault.index


async def _run_once(case: Case, folder: Path) -> tuple[Verdict, int]:
    process: list[BaseProcess] = []
    moving: list[BaseProcess] = []
    fault = case.fault
    async with (
        AsyncExitStack() as stack,
        station(folder, case.carrier, case.mode, fault, lambda: _strike(process, moving, fault)) as found,
    ):
        stack.push_async_callback(_end, moving)
        await asyncio.to_thread(shutil.copytree, _template(), folder / "store", dirs_exist_ok=True)
        told = folder / "told"
        takes_a_while = found.around.fault is not None or found.is_watched
        order = case.order or (LONG_ORDER if takes_a_while else ORDER)
        dark = found.around.fault is PlantFault.DARK_DATABASE
        await _move(found, told, moving)
        back = asyncio.create_task(_moved_again(found, told, moving))
        work = victim.run_watched_test if found.is_watched else victim.run_test
        # from when it went dark: a busy machine takes seconds to start a service
        until_s = (lambda: found.struck_s + _DARK_PATIENCE_S) if dark else (lambda: math.inf)
        await _live(work, (str(found.plant_file), str(told), dict(order)), process, until_s)
        await found.around.mend()
        lines = told_by(told)
        if not any(line["kind"] in ("end", "refused") for line in lines):
            # It died, and maybe what moves the valve: then the device's watchdog must act before anybody else does.
            safe = found.outlives_its_service or await found.until_safe(3.0 * WATCHDOG_S)
            if not moving[-1].is_alive():
                await asyncio.wait({back}, timeout=_PATIENCE_S)
            await _live(victim.recover, (str(found.plant_file), str(told)), [])
            lines = told_by(told)
            died_safe = safe
        else:
            died_safe = True
        back.cancel()
        safe = died_safe and await found.until_safe(4.0 * WATCHDOG_S)
        await asyncio.sleep(0.6)  # what was delayed on the wire arrives now, and must change nothing
        safe = safe and await found.until_safe(0.0)
        return judge(found, lines, safe=safe), len(found.wire.requests)


def _strike(process: list[BaseProcess], moving: list[BaseProcess], fault: FaultAt | None) -> None:
    """Do to the processes what the case wants done."""
    if fault is None or not isinstance(fault.fault, ServiceFault | PlantFault):
        return
    service, motion = process[0].pid, moving[0].pid
    if fault.fault is PlantFault.DARK_DATABASE:
        asyncio.get_running_loop().call_later(_STOP_AFTER_S, _stop, process[0])
    elif fault.fault is ServiceFault.STOP_AND_CONT and motion is not None:
        os.kill(motion, signal.SIGSTOP)
        asyncio.get_running_loop().call_later(2.0 * WATCHDOG_S, _continue, moving[0])
    elif isinstance(fault.fault, ServiceFault):
        for pid, signals in ((service, _OF_SERVICE), (motion, _OF_MOTION)):
            if pid is not None and fault.fault in signals:
                os.kill(pid, signals[fault.fault])


async def _move(found: Station, told: Path, moving: list[BaseProcess]) -> None:
    """Start what moves the valve, and wait until it can be asked."""
    socket = found.plant_file.parent / "store" / NAME
    socket.unlink(missing_ok=True)
    child = _CONTEXT.Process(target=victim.move, args=(str(found.plant_file), str(told)), daemon=True)
    await asyncio.to_thread(child.start)
    moving.append(child)
    until_s = time.monotonic() + _PATIENCE_S
    while not socket.exists() and child.is_alive() and time.monotonic() < until_s:  # noqa: ASYNC110  # of a process
        await asyncio.sleep(0.01)


async def _moved_again(found: Station, told: Path, moving: list[BaseProcess]) -> None:
    """Start it again once it has died, as a service manager does."""
    while moving[-1].is_alive():  # noqa: ASYNC110  # a process sets no event
        await asyncio.sleep(0.05)
    await asyncio.sleep(_MOTION_BACK_S)
    await _move(found, told, moving)


async def _end(moving: list[BaseProcess]) -> None:
    for child in moving:
        child.terminate()
        await asyncio.to_thread(child.join, _END_S)
        child.kill()
        await asyncio.to_thread(child.join)


def _stop(process: BaseProcess) -> None:
    """Press Stop in the service, without a request."""
    if process.is_alive() and process.pid is not None:
        os.kill(process.pid, signal.SIGUSR1)


def _continue(process: BaseProcess) -> None:
    if process.is_alive() and process.pid is not None:
        os.kill(process.pid, signal.SIGCONT)


async def _live(
    work: Callable[..., None],
    arguments: tuple[Any, ...],
    process: list[BaseProcess],
    until_s: Callable[[], float] = lambda: math.inf,
) -> None:
    """Let a process do its work and wait for its end, which is made for it after a minute, or at ``until_s``."""
    child = _CONTEXT.Process(target=work, args=arguments, daemon=True)
    process.append(child)
    await asyncio.to_thread(child.start)
    latest_s = time.monotonic() + _PATIENCE_S
    while child.is_alive():
        if time.monotonic() > min(latest_s, until_s()):
            child.kill()
        await asyncio.sleep(0.02)
    await asyncio.to_thread(child.join)
