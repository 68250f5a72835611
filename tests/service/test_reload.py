"""plant.toml read again while the service serves: what changes, what waits, what is told to need a restart."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config.settings import load_plant
from service.schedules.nightly import Nightly
from service.store.run_table import RunTable, ValveHead
from service.store.store import Store
from tests.service.nights import NIGHTLY, Clock, night, night_plant, plant_text
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.problem import assert_problem
from tests.support.running_service import running_service


@dataclass
class Reloadable:
    client: httpx.AsyncClient
    rig: FakeRig
    file: Path

    async def reload(self, text: str) -> httpx.Response:
        self.file.write_text(text, encoding="utf-8")
        return await self.client.post("/plant/reload")

    async def tags(self) -> list[str]:
        return [one["tag"] for one in (await self.client.get("/valves")).json()["valves"]]

    def audited(self) -> list[dict[str, Any]]:
        (log,) = (self.file.parent / "plant-data" / "audit").glob("*.audit")
        entries = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
        return [one for one in entries if one["event"].startswith("plant.")]


@asynccontextmanager
async def served(folder: Path, text: str, duration_s: float = 0.05) -> AsyncIterator[Reloadable]:
    file, rig = folder / "plant.toml", FakeRig(duration_s)
    file.write_text(text, encoding="utf-8")
    async with running_service(load_plant(file), rig, FakeAnalyst()) as client:
        yield Reloadable(client, rig, file)


TWO = service_text() + bus_text("a", 5020) + valve_text("A1", "a", 1) + valve_text("A2", "a", 2)


async def test_valves_come_change_and_go_without_a_restart(quick_path: Path) -> None:
    async with served(quick_path, TWO) as one:
        changed = valve_text("A1", "a", 1, rate_pa_per_s=12345.0)
        text = service_text() + bus_text("a", 5020) + bus_text("b", 5021) + changed + valve_text("B1", "b", 1)
        told = (await one.reload(text)).json()
        assert told["valves"] == {"added": ["B1"], "changed": ["A1"], "removed": ["A2"]}
        assert (told["buses_added"], told["waiting"], told["needs_restart"]) == (["b"], [], [])
        assert await one.tags() == ["A1", "B1"]
        assert (await one.client.get("/valves/A1")).json()["limits"]["pressure_rate_pa_per_s"] == 12345.0
        assert (await one.client.get("/valves/A2")).status_code == 404
        wait = {"Prefer": "wait=20"}
        run = await one.client.post("/tests/run", json={"valve": "B1", "sequence": "triangle"}, headers=wait)
        assert run.json()["state"] == "completed"
        assert (await one.client.get("/")).status_code == 200
        assert 'breakaway_motions_total{bus="b",' in (await one.client.get("/metrics")).text
    (entry,) = one.audited()
    assert (entry["event"], entry["who"]) == ("plant.reloaded", "local")
    assert entry["details"]["valves"]["removed"] == ["A2"]


async def test_a_valve_under_test_keeps_its_configuration_until_its_test_ends(quick_path: Path) -> None:
    async with served(quick_path, TWO, duration_s=1.5) as one:
        answer = await one.client.post("/tests/run", json={"valve": "A1", "sequence": "triangle"})
        assert answer.status_code == 202
        await one.rig.moving.wait()
        text = service_text() + bus_text("a", 5020) + valve_text("A2", "a", 2) + valve_text("A3", "a", 3)
        told = (await one.reload(text)).json()
        assert told["waiting"] == ["A1"]
        assert await one.tags() == ["A1", "A2", "A3"], "it is there, and can be stopped"
        again = (await one.reload(text)).json()
        assert again["valves"] == {"added": [], "changed": [], "removed": []}, "what waits is no change any more"
        stopped = await one.client.post("/valves/A1/stop")
        assert stopped.status_code == 200
        async with asyncio.timeout(20.0):
            while "A1" in (tags := await one.tags()):
                assert tags == ["A1", "A2", "A3"]
                await asyncio.sleep(0.05)
        assert one.rig.orders[0].tag == "A1"
        assert (await one.client.get("/")).status_code == 200


@pytest.mark.parametrize("asked", ["/valves", "/valves?format=csv", "/"])
async def test_a_list_that_a_reload_overtakes_has_the_valves_that_are_left(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    async with served(quick_path, TWO) as one:
        loop, heads = asyncio.get_running_loop(), RunTable.valve_heads

        def overtaken(table: RunTable, valves: Sequence[str] | None = None) -> dict[str, ValveHead]:
            text = service_text() + bus_text("a", 5020) + valve_text("A2", "a", 2)
            if valves and "A1" in valves:
                assert asyncio.run_coroutine_threadsafe(one.reload(text), loop).result(20.0).status_code == 200
            return heads(table, valves)

        monkeypatch.setattr(RunTable, "valve_heads", overtaken)
        answer = await one.client.get(asked)
        assert answer.status_code == 200
        assert "A2" in answer.text
        assert await one.tags() == ["A2"]


async def test_a_changed_valve_under_test_is_its_new_self_at_its_next_test(quick_path: Path) -> None:
    async with served(quick_path, TWO, duration_s=1.0) as one:
        run = (await one.client.post("/tests/run", json={"valve": "A1", "sequence": "triangle"})).json()
        await one.rig.moving.wait()
        slower = valve_text("A1", "a", 1, rate_pa_per_s=11111.0)
        await one.reload(service_text() + bus_text("a", 5020) + slower + valve_text("A2", "a", 2))

        async def rate() -> float:
            limits = (await one.client.get("/valves/A1")).json()["limits"]
            return float(limits["pressure_rate_pa_per_s"])

        assert await rate() == 30000.0
        async with asyncio.timeout(20.0):
            while await rate() != 11111.0:
                assert (await one.client.get(f"/tests/{run['id']}")).status_code == 200
                await asyncio.sleep(0.05)
        assert one.rig.wirings[0].limits.pressure_rate_pa_per_s == 30000.0


async def test_a_faulty_file_changes_nothing_and_every_fault_is_told(quick_path: Path) -> None:
    async with served(quick_path, TWO) as one:
        faulty = TWO.replace('bus = "a"', 'bus = "z"', 1).replace("device_id = 2", "device_id = 999")
        answer = await one.reload(faulty + valve_text("A3", "a", 3))
        assert_problem(answer, 422, 'bus = "z"', "999", "nothing has changed")
        assert await one.tags() == ["A1", "A2"]
        assert_problem(await one.reload("no toml ["), 422, "nothing has changed")
        moved = TWO.replace("5020", "5099") + valve_text("A3", "a", 3)
        assert_problem(await one.reload(moved), 422, "bus a was changed: that needs a restart")
        assert await one.tags() == ["A1", "A2"]
    entries = one.audited()
    assert [entry["event"] for entry in entries] == 3 * ["plant.reload_refused"]
    assert len(entries[0]["details"]["faults"]) == 2


async def test_what_needs_a_restart_is_told_and_stays(quick_path: Path) -> None:
    async with served(quick_path, TWO) as one:
        text = TWO.replace("port = 0", 'port = 8555\nallowed_hosts = ["x.example"]\nzone = "Asia/Tokyo"')
        told = (await one.reload(text.replace("plant-data", "elsewhere"))).json()
        assert told["needs_restart"] == [
            "service.store",
            "service.port",
            "service: who may reach it (access, TLS, proxy, hosts)",
        ]
        assert 'data-zone="Asia/Tokyo"' in (await one.client.get("/")).text


async def test_schedules_come_change_and_go(quick_path: Path) -> None:
    async with served(quick_path, plant_text(NIGHTLY)) as one:
        often = NIGHTLY.replace("30 2 * * *", "0 0 1 1 *")
        told = (
            await one.reload(plant_text(often + NIGHTLY.split("[[groups]]")[0].replace("nightly", "second")))
        ).json()
        assert told["schedules"] == {"added": ["second"], "changed": ["nightly"], "removed": []}
        listed = (await one.client.get("/schedules")).json()["schedules"]
        assert {schedule["name"]: schedule["last"] for schedule in listed} == {"nightly": None, "second": None}
        gone = (await one.reload(plant_text(""))).json()
        assert gone["schedules"]["removed"] == ["nightly", "second"]


async def test_a_schedule_that_was_moved_counts_from_the_reload_on(quick_path: Path) -> None:
    plant, store, clock = night_plant(quick_path), Store(quick_path / "s"), Clock(datetime(2026, 6, 30, 18, tzinfo=UTC))
    async with night(plant, store, FakeRig(), clock) as (nightly, _):
        clock.now += timedelta(hours=3)
        plant.schedules = (replace(plant.schedules[0], cron="0 21 * * *"),)  # two hours ago by the plant's clock
        nightly.schedules_changed()
        await nightly.look()
        assert store.schedule_runs.between(clock.now - timedelta(days=1), clock.now) == []
        clock.now += timedelta(days=1)
        await nightly.look()
        assert len(store.schedule_runs.between(clock.now - timedelta(days=1), clock.now)) == 3
    store.close()


async def test_the_nights_hear_of_a_reload(quick_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        Nightly, "schedules_changed", lambda self: heard.append(tuple(one.name for one in self._plant.schedules))
    )
    async with served(quick_path, plant_text(NIGHTLY)) as one:
        assert heard == []
        await one.reload(plant_text(NIGHTLY + NIGHTLY.split("[[groups]]")[0].replace("nightly", "second")))
        assert heard == [("nightly", "second")]


async def test_the_first_schedule_needs_a_restart(quick_path: Path) -> None:
    async with served(quick_path, plant_text("")) as one:
        told = (await one.reload(plant_text(NIGHTLY))).json()
        assert told["needs_restart"] == ["schedules (the first one)"]
        assert (await one.client.get("/schedules")).json()["schedules"] == []


@pytest.mark.parametrize("managed", [True, False])
async def test_a_service_manager_reloads_by_a_hang_up_and_a_closed_terminal_ends(
    quick_path: Path, managed: bool
) -> None:
    file = quick_path / "plant.toml"
    file.write_text(TWO, encoding="utf-8")
    environment = {key: value for key, value in os.environ.items() if key != "NOTIFY_SOCKET"}
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(quick_path / "notify"))
        if managed:
            environment["NOTIFY_SOCKET"] = str(quick_path / "notify")
        command = (sys.executable, "-m", "service.cli", "serve", "--config", str(file))
        process = await asyncio.create_subprocess_exec(*command, stdout=-1, stderr=-2, env=environment)
        assert process.stdout is not None
        try:
            async with asyncio.timeout(60.0):
                await _said(process.stdout, "listening")
                file.write_text(TWO + valve_text("A3", "a", 3), encoding="utf-8")
                process.send_signal(signal.SIGHUP)
                if managed:
                    assert '"added": ["A3"]' in await _said(process.stdout, "plant file taken over")
                    process.terminate()
                await _said(process.stdout, "ended")
                assert await process.wait() == 0
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()


async def _said(lines: asyncio.StreamReader, words: str) -> str:
    while line := (await lines.readline()).decode():
        if words in line:
            return line
    raise AssertionError(f"the service never said {words!r}")
