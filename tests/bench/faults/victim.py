"""What is under test, as processes that can be killed: what moves the valve, and the service's runs without HTTP."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import time
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final

import httpx
import structlog
import time_machine

from drivers import polled_play
from drivers.motion import program
from drivers.motion.audit_log import AuditLog
from drivers.motion.client import MotionClient
from drivers.motion.program import Moved, Place
from drivers.rows import PolledRows
from drivers.stands_at import StemVerdict
from service.access.principal import Role
from service.app import create_app
from service.cli.accounts import accounts
from service.cli.signals import ENDING_SIGNALS
from service.config.settings import load_plant
from service.http.given import part_of
from service.model.run import Run, RunState
from service.runs.service import Runs
from service.store.store import open_store
from tests.support.running_service import running_application
from valve.errors import ValveError

_PERSON: Final = "anna"
_PASSWORD: Final = "stem packing seat 7"
_IDLE: Final = timedelta(minutes=16)


class _NoAnalyst:
    async def analyze(self, *_what: Any, **_how: Any) -> dict[str, Any]:
        return {"schema": "breakaway/analysis/1", "estimates": []}


def _quiet() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


def move(plant_file: str, told: str) -> None:
    """Move the valve until a signal ends it."""
    _quiet()
    _tell_the_start(_Told(Path(told)))
    plant = load_plant(Path(plant_file))
    wirings = {tag: valve.wiring for tag, valve in plant.valves.items()}
    service = plant.service
    place = Place.in_store(service.store, service.motion_socket, service.gateway)
    program.run(lambda: Moved(plant.buses, wirings), place, "fault bench")


def run_test(plant_file: str, told: str, order: Mapping[str, Any]) -> None:
    """Run one test; what a client would have seen goes to the file ``told``, a JSON line each."""
    _quiet()
    asyncio.run(_run_test(Path(plant_file), Path(told), order))


def run_watched_test(plant_file: str, told: str, order: Mapping[str, Any]) -> None:
    """Do the same through the whole service, for a person whose session goes idle: SIGUSR2 presses Stop in it."""
    _quiet()
    asyncio.run(_run_watched_test(Path(plant_file), Path(told), order))


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
    motion = MotionClient(plant.service.motion_socket, store.folder / "journals")
    return Runs(plant, store, motion, _NoAnalyst(), software="fault bench", audit=audit)


def _seen(run: Run) -> dict[str, Any]:
    stem = None if run.stands is None else run.stands.verdict.value
    return {
        "id": run.id,
        "state": run.state.value,
        "safe_confirmed": run.safe_confirmed,
        "error": run.error,
        "stem": stem,
    }


def _tell_the_start(told: _Told) -> None:
    """Tell when the waveform begins: a recording counts its times from there."""

    def made(start_s: float) -> PolledRows:
        told.say(kind="waveform", start_s=start_s)
        return PolledRows(start_s)

    vars(polled_play)["PolledRows"] = made  # a judge looks on


async def _run_watched_test(plant_file: Path, told_file: Path, order: Mapping[str, Any]) -> None:
    told, idle = _Told(told_file), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR2, idle.set)
    with accounts(plant_file) as (access, _):
        access.add_user(_PERSON, Role.ENGINEER, _PASSWORD, by="fault bench")
    plant = load_plant(plant_file)
    motion = MotionClient(plant.service.motion_socket, plant.service.store / "journals")
    app = create_app(plant, motion, analyst=_NoAnalyst())
    async with running_application(app) as client:
        me = (await client.post("/session", json={"name": _PERSON, "password": _PASSWORD})).json()
        headers = {"X-CSRF-Token": me["csrf_token"]}
        answer = await client.post("/tests/run", json=dict(order), headers=headers)
        if answer.status_code != HTTPStatus.ACCEPTED:
            told.say(kind="refused", error=answer.text)
            return
        run_id = answer.json()["id"]
        told.say(kind="accepted", id=run_id)
        stopping = asyncio.create_task(_stop_in_idle_session(client, f"/tests/{run_id}", headers, idle))
        await _follow(part_of(app, Runs), run_id, told)
        stopping.cancel()


async def _stop_in_idle_session(
    client: httpx.AsyncClient, test: str, headers: Mapping[str, str], idle: asyncio.Event
) -> None:
    await client.get(f"/ui{test}")  # the page that is open
    await idle.wait()
    with time_machine.travel(datetime.now(UTC) + _IDLE, tick=True):
        assert (await client.get(test)).status_code == HTTPStatus.UNAUTHORIZED
        await client.post(f"{test}/stop", headers=headers)


async def _run_test(plant_file: Path, told_file: Path, order: Mapping[str, Any]) -> None:
    told, runs = _Told(told_file), _runs(plant_file)
    for ending in ENDING_SIGNALS:
        asyncio.get_running_loop().add_signal_handler(ending, runs.begin_shutdown)
    try:
        run = await runs.start(order["valve"], order["sequence"], order["overrides"])
    except ValveError as error:
        told.say(kind="refused", error=str(error))
        return
    told.say(kind="accepted", id=run.id)
    stopping: list[asyncio.Task[Run]] = []
    asyncio.get_running_loop().add_signal_handler(
        signal.SIGUSR1, lambda: stopping.append(asyncio.create_task(runs.stop(run.id)))
    )
    await _follow(runs, run.id, told)


async def _follow(runs: Runs, run_id: str, told: _Told) -> None:
    """Tell what a watcher sees, and how it ended once the stem was looked at."""
    async for events in await runs.follow(run_id, 0):
        for event in events:
            if event.kind == "samples":
                told.say(kind="samples", time_s=event.data["time_s"], position_m=event.data["position_m"])
    run = await runs.get(run_id)
    if not run.state.finished:
        return  # it was asked to end amid the motion, which goes on
    if run.state is RunState.INTERRUPTED:
        await runs.settled()  # the motion was lost: its valve is looked at as soon as that can be
    stands = (await runs.get(run_id)).stands
    while stands is not None and stands.safe_position_m is not None and stands.verdict is StemVerdict.MOVING:
        await asyncio.sleep(0.05)
        stands = (await runs.get(run_id)).stands
    await runs.shut_down()
    told.say(kind="end", **_seen(await runs.get(run_id)))


async def _recover(plant_file: Path, told_file: Path) -> None:
    told, runs = _Told(told_file), _runs(plant_file)
    await runs.recover()
    await runs.settled()
    for run in await runs.newest(1):
        told.say(kind="end", **_seen(run))
