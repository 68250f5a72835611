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
from tests.faults import victim
from tests.faults.judge import Verdict, judge, told_by
from tests.faults.station import ORDER, WATCHDOG_S, Carrier, Mode, station
from tests.faults.wire_faults import FaultAt, ServiceFault

_PATIENCE_S: Final = 60.0
_ATTEMPTS: Final = 5
_CONTEXT: Final = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.faults.victim"])


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
    shutil.copytree(_template(), folder / "store")
    process: list[BaseProcess] = []
    fault = case.fault
    async with station(folder, case.carrier, case.mode, fault, lambda: _strike(process, fault)) as found:
        told = folder / "told"
        await _live(victim.run_test, (str(found.plant_file), str(told), dict(case.order or ORDER)), process)
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
    if fault is None or not isinstance(fault.fault, ServiceFault) or process[0].pid is None:
        return
    pid = process[0].pid
    if fault.fault is ServiceFault.STOP_AND_CONT:
        os.kill(pid, signal.SIGSTOP)
        asyncio.get_running_loop().call_later(2.0 * WATCHDOG_S, _continue, process[0])
    else:
        os.kill(pid, signal.SIGKILL if fault.fault is ServiceFault.KILL else signal.SIGTERM)


def _continue(process: BaseProcess) -> None:
    if process.is_alive() and process.pid is not None:
        os.kill(process.pid, signal.SIGCONT)


async def _live(work: Callable[..., None], arguments: tuple[Any, ...], process: list[BaseProcess]) -> None:
    """Let a process do its work and wait for its end."""
    child = _CONTEXT.Process(target=work, args=arguments, daemon=True)
    process.append(child)
    await asyncio.to_thread(child.start)
    until_s = time.monotonic() + _PATIENCE_S
    while child.is_alive():
        if time.monotonic() > until_s:
            child.kill()
        await asyncio.sleep(0.02)
    await asyncio.to_thread(child.join)
