"""A plant at night: valves on two buses, a clock that tests set, and a queue without a disk."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path

from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.check import Check
from service.runs.service import Runs
from service.schedules.nightly import Nightly
from service.store.store import Store
from tests.service.stored_runs import runs_of
from tests.support.fake_rig import FakeRig
from tests.support.plants import bus_text, service_text, valve_text

NIGHTLY = """
[[schedules]]
name = "nightly"
cron = "30 2 * * *"
zone = "Europe/Berlin"
groups = ["all"]
sequence = "triangle"
window_s = 3600.0
[[groups]]
name = "all"
valves = ["A1", "A2", "B1"]
"""


def plant_text(more: str = NIGHTLY, service: str = "", gateways: tuple[str, str] = ("", "")) -> str:
    """Return plant.toml of valves A1 and A2 on bus a, B1 on bus b."""
    text = service_text(service)
    for number, (bus, gateway) in enumerate(zip("ab", gateways, strict=True)):
        text += bus_text(bus, 5020 + number, f'gateway = "{gateway}"' if gateway else "")
    for tag, bus, device_id in (("A1", "a", 1), ("A2", "a", 2), ("B1", "b", 1)):
        text += valve_text(tag, bus, device_id, signal=False)
    return text + more


def night_plant(folder: Path, more: str = NIGHTLY, service: str = "") -> Plant:
    path = folder / "plant.toml"
    path.write_text(plant_text(more, service), encoding="utf-8")
    return load_plant(path)


class Clock:
    """Tells what it was set to."""

    def __init__(self, now: datetime) -> None:
        self.now = now

    def __call__(self) -> datetime:
        return self.now


class MemoryQueue:
    """One check a bus at a time, in order, as the durable queue does it."""

    def __init__(self, nightly: Nightly) -> None:
        self._nightly = nightly
        self._loop = asyncio.get_running_loop()
        self._buses: dict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self.jobs: list[str] = []

    def enqueue(self, job_id: str, bus: str, check_id: int) -> None:
        self.jobs.append(job_id)
        asyncio.run_coroutine_threadsafe(self._in_turn(bus, check_id), self._loop)

    async def _in_turn(self, bus: str, check_id: int) -> None:
        async with self._buses[bus]:
            await self._nightly.carry_out(check_id)


@asynccontextmanager
async def night(plant: Plant, store: Store, rig: FakeRig, clock: Clock) -> AsyncIterator[tuple[Nightly, Runs]]:
    """Hand out the schedules and the runs of a service that has just started."""
    runs = runs_of(plant, store, rig)
    nightly = Nightly(plant, store, runs, clock)
    try:
        await runs.recover()
        await nightly.prepare()
        await nightly.start(MemoryQueue(nightly))
        yield nightly, runs
    finally:
        nightly.stop_waiting()
        await runs.shut_down()
        await nightly.close()


async def until(store: Store, done: Callable[[list[Check]], bool], deadline_s: float = 60.0) -> list[Check]:
    """Return all checks of the store once they satisfy ``done``."""
    ends = asyncio.get_running_loop().time() + deadline_s
    while True:
        checks = store.schedule_runs.between(datetime(1970, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC))
        if done(checks):
            return checks
        assert asyncio.get_running_loop().time() < ends, [(one.valve, one.state, one.reason) for one in checks]
        await asyncio.sleep(0.01)
