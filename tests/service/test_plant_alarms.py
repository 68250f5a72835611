"""Alarms of the plant: a motion process that does not answer, and one that has read another plant file."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.addresses import TcpAddress
from drivers.motion.orders import MotionLostError
from drivers.motion.plant_read import PlantRead, plant_read, valve_read
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.plant_alarm import AlarmKind
from service.model.run import Run, RunState, new_run_id
from service.runs.motion_watch import MotionWatch
from service.store.store import Store
from tests.service.access.signed_in import body_of
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.processes import moving, serving, until
from tests.support.running_service import running_service
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, wired_plant
from valve.errors import BusyError

SHORT = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 1.0, "low_pa": 30_000.0, "high_pa": 40_000.0}}
NOON = datetime(2026, 11, 28, 12, tzinfo=UTC)


class Asked:
    """A way to a motion process that answers what it is told to."""

    def __init__(self, *answers: Any) -> None:
        self._answers = iter(answers)

    async def plant_read(self, digest: str) -> PlantRead | None:
        answer = next(self._answers)
        if isinstance(answer, Exception):
            raise answer
        if answer == "hangs":
            await asyncio.Event().wait()
        return None if answer is None or answer.digest == digest else answer


def _read(plant: Plant) -> PlantRead:
    return plant_read([valve.wiring for valve in plant.valves.values()], plant.buses)


def _watch(plant: Plant, *answers: Any) -> MotionWatch:
    minutes: Iterator[int] = iter(range(100))
    motion: Any = Asked(*answers)
    return MotionWatch(plant, motion, clock=lambda: NOON + timedelta(minutes=next(minutes)))


def _kinds(watch: MotionWatch) -> list[AlarmKind]:
    return [alarm.kind for alarm in watch.alarms]


def _wired_otherwise(plant: Plant, tag: str, **changes: Any) -> Plant:
    valve = plant.valves[tag]
    return replace(plant, valves={**plant.valves, tag: replace(valve, wiring=replace(valve.wiring, **changes))})


async def _alarms(client: httpx.AsyncClient) -> list[dict[str, Any]]:
    alarms: list[dict[str, Any]] = body_of(await client.get("/alarms"))["alarms"]
    return alarms


async def test_an_alarm_stands_from_the_first_look_that_failed_until_one_is_answered(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.runs.motion_watch._ANSWER_S", 0.01)
    watch = _watch(plant, None, MotionLostError("long", "not there"), "hangs", BusyError("another version"), None)
    await watch.look()
    assert _kinds(watch) == []
    await watch.look()
    (first,) = watch.alarms
    assert (first.kind, first.since, first.valves) == (AlarmKind.MOTION_PROCESS, NOON, ())
    assert "(not there)" in first.sentence
    assert "systemctl status breakaway-motion" in first.remedy
    for _ in range(2):
        await watch.look()
        assert watch.alarms == (first,)
    await watch.look()
    assert _kinds(watch) == []


async def test_a_process_that_hangs_and_one_of_another_version_are_alarms_too(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.runs.motion_watch._ANSWER_S", 0.01)
    for answer, word in (("hangs", "nothing heard for"), (BusyError("it speaks version 1"), "speaks version 1")):
        watch = _watch(plant, answer)
        await watch.look()
        assert word in watch.alarms[0].sentence


async def test_another_plant_file_is_an_alarm_once_two_looks_have_seen_it(plant: Plant) -> None:
    other = _wired_otherwise(plant, "FV-102", safe_value_pa=5000.0)
    watch = _watch(plant, *[_read(other)] * 3, MotionLostError("gone"), _read(other), _read(plant))
    await watch.look()
    assert _kinds(watch) == [], "a reload takes one after the other"
    await watch.look()
    (alarm,) = watch.alarms
    assert (alarm.kind, alarm.since, alarm.valves) == (AlarmKind.PLANT_FILE, NOON, ("FV-102",))
    assert "breakaway reload" in alarm.remedy
    await watch.look()
    assert watch.alarms == (alarm,)
    await watch.look()
    assert _kinds(watch) == [AlarmKind.MOTION_PROCESS], "what it has read is not known now"
    await watch.look()
    await watch.look()
    assert _kinds(watch) == []


async def test_a_bus_at_another_address_needs_a_restart(plant: Plant) -> None:
    moved = replace(plant, buses={**plant.buses, "plc-1": TcpAddress("plc-1", "127.0.0.1", 5099)})
    watch = _watch(plant, *[_read(moved)] * 2)
    await watch.look()
    await watch.look()
    (alarm,) = watch.alarms
    assert alarm.valves == ("FV-101", "FV-102")
    assert "bus plc-1" in alarm.sentence
    assert alarm.remedy.startswith("systemctl restart")


def test_all_that_decides_how_a_valve_moves_is_in_its_fingerprint_and_nothing_else(plant: Plant) -> None:
    wiring, buses = plant.valves["FV-102"].wiring, plant.buses
    was = valve_read(wiring, buses)
    changed = (
        replace(wiring, limits=replace(wiring.limits, longest_test_s=299.0)),
        replace(wiring, safe_value_pa=0.0),
        replace(wiring, command=replace(wiring.command, device_id=7)),
        replace(wiring, permissives=replace(wiring.permissives, permit=True)),
        replace(wiring, rest=replace(wiring.rest, after_s=33.0)),
        replace(wiring, watchdog=replace(wiring.watchdog, timeout_s=3.0)),
    )
    assert len({was, *(valve_read(one, buses) for one in changed)}) == 1 + len(changed)
    assert valve_read(wiring, {**buses, "another": TcpAddress("another", "127.0.0.1")}) == was
    assert valve_read(wiring, {**buses, "plc-1": TcpAddress("plc-1", "127.0.0.9", 5020)}) != was
    assert valve_read(load_plant(plant.file).valves["FV-102"].wiring, load_plant(plant.file).buses) == was


async def test_a_valve_that_nobody_has_looked_at_is_in_the_list_of_alarms(plant: Plant) -> None:
    store = Store(plant.service.store)
    run = store.runs.insert(Run(new_run_id(), "FV-101", "triangle"))
    store.runs.save(replace(run, state=RunState.FAILED, safe_confirmed=False, commanded=True, error="no answer"))
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        (alarm,) = await _alarms(client)
        assert (alarm["alarm"], alarm["valves"]) == ("valve", ["FV-101"])
        assert "SAFE STATE NOT CONFIRMED" in alarm["sentence"]
        assert "breakaway acknowledge FV-101" in alarm["remedy"]
        await client.post(f"/tests/{run.id}/acknowledge", json={"note": "it stands closed"})
        assert await _alarms(client) == []


async def test_a_killed_motion_process_is_an_alarm_on_the_list_until_it_is_back(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _), serving(path) as (_, client):

        async def is_there() -> bool:
            return await _alarms(client) == []

        async def is_lost() -> bool:
            return [one["alarm"] for one in await _alarms(client)] == ["motion_process"]

        async with moving(path) as motion:
            await until(is_there, 20.0, "the end of the alarm of a start without a motion process")
            motion.kill()
            await until(is_lost, 20.0, "the alarm")
        shown = (await client.get("/")).text
        assert "The motion process does not answer" in shown
        assert "systemctl status breakaway-motion" in shown
        assert 'breakaway_plant_alarm{alarm="motion_process"} 1.0' in (await client.get("/metrics")).text
        assert (await client.post("/tests/run", json=SHORT)).status_code == 503
        async with moving(path):
            await until(is_there, 20.0, "the end of the alarm")
            assert "does not answer" not in (await client.get("/")).text
            assert 'breakaway_plant_alarm{alarm="motion_process"} 0.0' in (await client.get("/metrics")).text


async def test_a_valve_is_not_moved_by_other_limits_than_the_tablet_shows(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, plant), moving(path) as first, serving(path) as (_, client):
        first.kill()
        await first.wait()
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace("longest_test_s = 300.0", "longest_test_s = 200.0"), encoding="utf-8")
        async with moving(path):

            async def differs() -> bool:
                return [(one["alarm"], one["valves"]) for one in await _alarms(client)] == [("plant_file", [TAG])]

            async def is_same() -> bool:
                return await _alarms(client) == []

            await until(differs, 20.0, "the alarm")
            assert "breakaway reload" in (await client.get("/")).text
            assert_problem(await client.post("/tests/run", json=SHORT), 423, "plant_file", "breakaway reload")
            assert body_of(await client.get("/tests"))["tests"] == []
            body_of(await client.post("/plant/reload"))
            await until(is_same, 20.0, "the end of the alarm")
            done = body_of(await client.post("/tests/run", json=SHORT, headers={"Prefer": "wait=60"}))
            assert (done["state"], done["safe_confirmed"]) == ("completed", True), done["error"]
            assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
