"""One case: a station, a service in a process of its own, a fault at one transaction, and the verdict."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Final

from service.store.store import Store
from tests.bench.faults import victim
from tests.bench.faults.judge import Verdict, judge, told_by
from tests.bench.faults.station import LONG_ORDER, ORDER, WATCHDOG_S, Carrier, Mode, station
from tests.bench.faults.wire_faults import FaultAt, PlantFault, ServiceFault

_PATIENCE_S: Final = 60.0
_STOP_AFTER_S: Final = 0.1  # from a database that answers no more to a stop
_SIGNALS: Final = {
    ServiceFault.KILL: signal.SIGKILL,
    ServiceFault.TERM: signal.SIGTERM,
    ServiceFault.HANG_UP: signal.SIGHUP,
    ServiceFault.IDLE_SESSION: signal.SIGUSR2,
}
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
    fault = case.fault
    async with station(folder, case.carrier, case.mode, fault, lambda: _strike(process, fault)) as found:
        await asyncio.to_thread(shutil.copytree, _template(), folder / "store", dirs_exist_ok=True)
        told = folder / "told"
        takes_a_while = found.around.fault is not None or found.is_watched
        order = case.order or (LONG_ORDER if takes_a_while else ORDER)
        dark = found.around.fault is PlantFault.DARK_DATABASE
        patience_s = _DARK_PATIENCE_S if dark else _PATIENCE_S
        work = victim.run_watched_test if found.is_watched else victim.run_test
        await _live(work, (str(found.plant_file), str(told), dict(order)), process, patience_s)
        await found.around.mend()
        lines = told_by(told)
        if not any(line["kind"] in ("end", "refused") for line in lines):
            # It died: the device's watchdog must act before anybody else does.
            safe = await found.until_safe(3.0 * WATCHDOG_S)
            await _live(victim.recover, (str(found.plant_file), str(told)), [])
            lines = told_by(told)
            died_safe = safe
        else:
            died_safe = True
        safe = died_safe and await found.until_safe(4.0 * WATCHDOG_S)
        await asyncio.sleep(0.6)  # what was delayed on the wire arrives now, and must change nothing
        safe = safe and await found.until_safe(0.0)
        return judge(found, lines, safe=safe), len(found.wire.requests)


def _strike(process: list[BaseProcess], fault: FaultAt | None) -> None:
    """Do to the service what the case wants done."""
    if fault is None or process[0].pid is None:
        return
    pid = process[0].pid
    if fault.fault is PlantFault.DARK_DATABASE:
        asyncio.get_running_loop().call_later(_STOP_AFTER_S, _stop, process[0])
    elif fault.fault is ServiceFault.STOP_AND_CONT:
        os.kill(pid, signal.SIGSTOP)
        asyncio.get_running_loop().call_later(2.0 * WATCHDOG_S, _continue, process[0])
    elif isinstance(fault.fault, ServiceFault):
        os.kill(pid, _SIGNALS[fault.fault])


def _stop(process: BaseProcess) -> None:
    """Press Stop in the service, without a request."""
    if process.is_alive() and process.pid is not None:
        os.kill(process.pid, signal.SIGUSR1)


def _continue(process: BaseProcess) -> None:
    if process.is_alive() and process.pid is not None:
        os.kill(process.pid, signal.SIGCONT)


async def _live(
    work: Callable[..., None], arguments: tuple[Any, ...], process: list[BaseProcess], patience_s: float = _PATIENCE_S
) -> None:
    """Let a process do its work and wait for its end."""
    child = _CONTEXT.Process(target=work, args=arguments, daemon=True)
    process.append(child)
    await asyncio.to_thread(child.start)
    until_s = time.monotonic() + patience_s
    while child.is_alive():
        if time.monotonic() > until_s:
            child.kill()
        await asyncio.sleep(0.02)
    await asyncio.to_thread(child.join)
