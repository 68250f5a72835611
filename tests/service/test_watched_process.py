"""A simulated valve that its controller moves, read in service by the motion process as a plant runs it."""

from __future__ import annotations

import asyncio
import resource
import signal
from contextlib import AbstractAsyncContextManager
from datetime import UTC, datetime, time, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.motion.client import MotionClient
from drivers.motion.watch_file import WatchFileWriter, day_of, days_in, read_watch_file
from service.config.settings import load_plant
from simulator.assembly import SimulatedPlant
from tests.estimators.in_service.records import AREA_M2, BENCH_PA, BREAKAWAY_PA, FRICTION_PA, TRAVEL_M, record
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.processes import Condition, moving, serving, until
from tests.support.watching import meanwhile
from tests.support.wired_plant import TAG, wired_plant

WATCH = "[valves.watch]\nperiod_s = 0.02\n"
LOW_PA, HIGH_PA = 10_000.0, 75_000.0
STROKE_S = 3.0


def controlled(plant: SimulatedPlant) -> AbstractAsyncContextManager[None]:
    """Have a controller beside us drive the valve's I/P up and down."""

    async def drive() -> None:
        valve, began_s = plant.valves[TAG], plant.clock.now_s()
        while True:
            plant.look()
            turns = (plant.clock.now_s() - began_s) / STROKE_S
            share = abs(turns % 2.0 - 1.0)
            valve.ask(LOW_PA + (HIGH_PA - LOW_PA) * share)
            await asyncio.sleep(0.01)

    return meanwhile(drive())


async def test_a_killed_motion_process_leaves_what_it_read_and_the_next_one_goes_on_with_it(quick_path: Path) -> None:
    async with wired_plant(quick_path, more=WATCH) as (path, plant), controlled(plant):
        plan = load_plant(path)
        folder = plan.service.store / "watched"
        async with moving(path) as process:

            async def is_kept() -> bool:
                return sum(day.path.stat().st_size for day in days_in(folder)) > 250 * 20

            await until(is_kept, 60.0, "the first blocks on disk")
            client = MotionClient(plan.service.motion_socket, plan.service.store / "journals")
            counted = (await client.watched())[TAG]
            await client.close()
            process.send_signal(signal.SIGKILL)
            await process.wait()
        assert counted["read"] >= counted["kept"] >= 250
        assert counted["failed"] == 0
        (day,) = days_in(folder)
        header, left = read_watch_file(day.path)
        assert header["valve"] == TAG
        assert len(left) >= 250
        assert np.ptp(left[:, 1]) > 0.01
        async with moving(path) as process:
            await until(is_larger(day.path), 60.0, "further blocks on disk")
            process.send_signal(signal.SIGTERM)
            await asyncio.wait_for(process.wait(), 30.0)
        rows = read_watch_file(day.path)[1]
        assert np.array_equal(rows[: len(left)], left)
        assert len(rows) > len(left)
        assert np.all(np.diff(rows[:, 0]) > 0.0)
        assert plant.records[TAG].events == ()  # nothing was written to its device


async def test_the_motion_process_may_open_as_many_files_as_the_system_allows(quick_path: Path) -> None:
    """A file a watched valve: those of 1,250 must not leave a test without its bus or journal."""
    path = quick_path / "plant.toml"
    path.write_text(service_text() + bus_text("plc-1", 9) + valve_text(TAG, "plc-1", more=WATCH), encoding="utf-8")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(512, hard), hard))
    try:
        async with moving(path) as process:
            assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE) == (min(hard, 65536), hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def size_of(path: Path) -> int:
    return path.stat().st_size


def is_larger(path: Path) -> Condition:
    size = size_of(path)

    async def grown() -> bool:
        return size_of(path) > size

    return grown


@pytest.mark.long  # the same without its processes: test_watched_days
async def test_the_service_judges_a_day_that_is_over_by_itself(quick_path: Path) -> None:
    """A day of exact stick-slip stands in the store; motion process and service are started as a plant starts them."""
    yesterday = datetime.now(UTC).date() - timedelta(days=2)
    made = record(1.0, 0.1)
    assert made.pressure_pa is not None
    at_s = datetime.combine(yesterday, time(8), UTC).timestamp() + made.time_s
    writer = WatchFileWriter(day_of(quick_path / "plant-data" / "watched", TAG, yesterday), {"period_s": 0.1})
    writer.append(np.column_stack((at_s, made.position_m, made.pressure_pa, np.full(made.samples, np.nan))))
    writer.close()
    valve = valve_text(
        TAG, "plc-1", actuator=(AREA_M2, TRAVEL_M), pressure_pa=BENCH_PA, safe=str(BENCH_PA[0]), more=WATCH
    )
    path = quick_path / "plant.toml"
    path.write_text(service_text('zone = "UTC"') + bus_text("plc-1", 9) + valve, encoding="utf-8")
    async with moving(path), serving(path) as (_, client):

        async def is_judged() -> bool:
            return bool((await client.get(f"/valves/{TAG}/watched")).json()["days"])

        await until(is_judged, 240.0, "the day's judgement")
        body = (await client.get(f"/valves/{TAG}/watched")).json()
        metrics = (await client.get("/metrics")).text
    assert "bus plc-1" in body["unread"]["reason"]  # nobody answers at its bus
    (day,) = body["days"]
    assert (day["day"], day["reason"], day["rows"]) == (yesterday.isoformat(), "", made.samples)
    figures = day["result"]["figures"]
    for name, truth_pa in (("friction", FRICTION_PA), ("breakaway", BREAKAWAY_PA)):
        assert figures[name]["ci95"][0] <= truth_pa * AREA_M2 <= figures[name]["ci95"][1], name
    assert f'breakaway_watch_slots_total{{outcome="failed",valve="{TAG}"}}' in metrics  # nobody answers at its bus
