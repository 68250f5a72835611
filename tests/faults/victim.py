"""The service under test, as a process that can be killed: its runs, store, audit log and rig, without HTTP."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import structlog

from drivers import polled_play
from drivers.rows import PolledRows
from service.audit.log import AuditLog
from service.runs.run import Run
from service.runs.service import Runs
from service.settings import load_plant
from service.store.store import open_store
from service.wired_rig import WiredRig
from valve.errors import ValveError


class _NoAnalyst:
    async def analyze(self, *_what: Any, **_how: Any) -> dict[str, Any]:
        return {"schema": "breakaway/analysis/1", "estimates": []}


def _quiet() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


def run_test(plant_file: str, told: str, order: Mapping[str, Any]) -> None:
    """Run one test; what a client would have seen goes to the file ``told``, a JSON line each."""
    _quiet()
    asyncio.run(_run_test(Path(plant_file), Path(told), order))


def recover(plant_file: str, told: str) -> None:
    """Start again after a death and end as soon as everything that it left is dealt with."""
    _quiet()
    asyncio.run(_recover(Path(plant_file), Path(told)))


class _Told:
    """What was told to the outside, on disk at once and by no buffer: it survives this process."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def say(self, **what: Any) -> None:
        os.write(self._file, json.dumps({**what, "mono_s": time.monotonic()}).encode() + b"\n")


def _runs(plant_file: Path) -> Runs:
    plant = load_plant(plant_file)
    store = open_store(plant.service)
    audit = AuditLog(store.folder / "audit")
    return Runs(plant, store, WiredRig(plant.buses, "fault bench"), _NoAnalyst(), software="fault bench", audit=audit)


def _seen(run: Run) -> dict[str, Any]:
    return {"id": run.id, "state": run.state.value, "safe_confirmed": run.safe_confirmed, "error": run.error}


def _tell_the_start(told: _Told) -> None:
    """Tell when the waveform begins: a recording counts its times from there."""

    def made(start_s: float) -> PolledRows:
        told.say(kind="waveform", start_s=start_s)
        return PolledRows(start_s)

    vars(polled_play)["PolledRows"] = made  # a judge looks on


async def _run_test(plant_file: Path, told_file: Path, order: Mapping[str, Any]) -> None:
    told, runs = _Told(told_file), _runs(plant_file)
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, runs.begin_shutdown)
    _tell_the_start(told)
    try:
        run = await runs.start(order["valve"], order["sequence"], order["overrides"])
    except ValveError as error:
        told.say(kind="refused", error=str(error))
        return
    told.say(kind="accepted", id=run.id)
    async for events in await runs.follow(run.id, 0):
        for event in events:
            if event.kind == "samples":
                told.say(kind="samples", time_s=event.data["time_s"], position_m=event.data["position_m"])
    await runs.shut_down()
    told.say(kind="end", **_seen(await runs.get(run.id)))


async def _recover(plant_file: Path, told_file: Path) -> None:
    told, runs = _Told(told_file), _runs(plant_file)
    await runs.recover()
    await runs.settled()
    for run in await runs.newest(1):
        told.say(kind="end", **_seen(run))
