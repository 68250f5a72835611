"""Stored tests analysed anew: all of a time, behind everything else, once, whatever happens to the service."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.audit.verify import entries_of
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.store.store import Store, open_store
from tests.service.access.signed_in import body_of
from tests.service.command_line import called
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.nominal_recordings import triangle_test
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.errors import RecordingError

LONG_AGO = datetime(2026, 3, 1, 12, tzinfo=UTC)
SINCE = {"since": "2026-03-01"}
DEADLINE_S = 120.0


def _kept(store: Store, valve: str, at: datetime, **more: Any) -> Run:
    """Store a completed test of that time with its recording."""
    run = Run(id=new_run_id(at), valve=valve, sequence="triangle", created_at=at, finished_at=at)
    file, sha256 = store.write_recording(run.id, triangle_test(0.05))
    analysis = {"schema": "breakaway/analysis/1", "first": True, "discrepancy": {"verdict": "none"}, "estimates": []}
    done: dict[str, Any] = {
        "state": RunState.COMPLETED,
        "safe_confirmed": True,
        "commanded": True,
        "analysis": analysis,
        "progress": 1.0,
    }
    stored = store.runs.insert(replace(run, recording_file=file, recording_sha256=sha256, **done))
    changes = {"gateway": store.gateway, "quality": {"ended": "completed"}, **more}
    return store.runs.change(stored.id, changes)


def _filled(plant: Plant, count: int) -> list[Run]:
    """Put completed tests, one an hour, into the store of a plant, of its two valves in turn."""
    store = open_store(plant.service)
    try:
        return [
            _kept(store, ("FV-101", "FV-102")[number % 2], LONG_AGO + timedelta(hours=number))
            for number in range(count)
        ]
    finally:
        store.close()


async def _ended(client: httpx.AsyncClient, href: str) -> dict[str, Any]:
    async with asyncio.timeout(DEADLINE_S):
        while (found := body_of(await client.get(href)))["state"] in ("queued", "running"):  # noqa: ASYNC110
            await asyncio.sleep(0.05)
    return dict(found)


class _Picky(FakeAnalyst):
    """Fails with one recording."""

    def __init__(self, bad: str) -> None:
        super().__init__()
        self.bad = bad

    async def analyze(self, recording_path: Path, *args: Any, **more: Any) -> dict[str, Any]:
        if recording_path.stem == self.bad:
            raise RecordingError("it is not what it was")
        return await super().analyze(recording_path, *args, **more)


async def test_all_tests_of_a_time_are_analysed_anew_behind_everything_else_and_a_failure_costs_no_result(
    plant_file: Path,
) -> None:
    plant = load_plant(plant_file)
    runs = _filled(plant, 4)
    analyst, rig = _Picky(runs[2].id), FakeRig()
    async with running_service(plant, rig, analyst) as client:
        body = {"since": "2026-03-01T13:00:00Z"}  # the first one was before
        plan = body_of(await client.post("/reanalyses", json={**body, "dry_run": True}))
        assert (plan["tests"], plan["elsewhere"], analyst.asked) == (3, {}, [])
        answer = await client.post("/reanalyses", json=body)
        assert (answer.status_code, answer.headers["location"]) == (202, answer.json()["href"])
        assert (answer.json()["total"], answer.json()["requested_by"]) == (3, "local")
        found = await _ended(client, answer.json()["href"])
        assert (found["state"], found["done"], found["tests"]["completed"], found["tests"]["failed"]) == (
            "ended",
            3,
            2,
            1,
        )
        (trouble,) = found["troubles"]
        assert (trouble["test"], "not what it was" in trouble["reason"]) == (runs[2].id, True)
        tests = [body_of(await client.get(f"/tests/{run.id}")) for run in runs]
        assert [test["state"] for test in tests] == ["completed"] * 4
        assert ["first" in test["analysis"] for test in tests] == [True, False, True, False]
        assert tests[1]["analysis"]["repeated"]["by"] == "local"
        assert (analyst.behind, rig.orders, rig.safe_calls) == (2, [], [])
        assert [one["number"] for one in body_of(await client.get("/reanalyses"))["reanalyses"]] == [found["number"]]
        assert_problem(await client.get("/reanalyses/99"), 404, "GET /reanalyses lists")
    (log,) = (plant.service.store / "audit").iterdir()
    (entry,) = [one for one in entries_of(log) if one.event.startswith("analys")]
    assert (entry.event, entry.who, entry.details["tests"]) == ("analyses.repeated", "local", 3)


async def test_what_is_asked_for_twice_is_the_same_and_what_is_stopped_ends_with_the_test_under_way(
    plant_file: Path,
) -> None:
    plant = load_plant(plant_file)
    _filled(plant, 3)
    analyst = FakeAnalyst()
    analyst.let_go.clear()
    async with running_service(plant, FakeRig(), analyst) as client:
        first = body_of(await client.post("/reanalyses", json=SINCE))
        assert body_of(await client.post("/reanalyses", json=SINCE))["number"] == first["number"]
        other = {"since": "2026-02-28", "valve": "FV-101"}
        assert_problem(await client.post("/reanalyses", json=other), 409, "2 tests of that time are queued")
        async with asyncio.timeout(DEADLINE_S):
            while not analyst.asked:  # noqa: ASYNC110  - it is looked at from outside
                await asyncio.sleep(0.02)
        stopped = body_of(await client.post(f"{first['href']}/stop"))
        assert (stopped["tests"]["stopped"], stopped["stopped_by"]) == (2, "local")
        analyst.let_go.set()
        found = await _ended(client, first["href"])
        assert (found["state"], found["tests"]["completed"], found["tests"]["stopped"]) == ("stopped", 1, 2)


async def test_a_request_that_makes_no_sense_is_refused_with_the_remedy(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    _filled(plant, 1)
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        for body, status, words in (
            ({"since": "2999-01-01"}, 422, "is in the future"),
            ({"since": "tomorrow"}, 422, "since"),
            ({"since": "2026-03-01", "until": "2026-02-01"}, 422, "give a later until"),
            ({"since": "2026-03-01", "valve": "FV-999"}, 404, "GET /valves lists all"),
            ({"since": "2026-03-02"}, 404, "give an earlier since"),
            ({"since": "2026-03-01", "valve": "FV-102"}, 404, "FV-102: no test since 2026-03-01 00:00 UTC"),
            ({"since": "2026-03-01", "sinse": 1}, 422, "sinse"),
        ):
            assert_problem(await client.post("/reanalyses", json=body), status, words)
            if "sinse" not in body:
                assert_problem(
                    await client.post("/reanalyses", json={**body, "older_only": True}),
                    status,
                    words.split(" since")[0],
                )


async def test_only_tests_with_a_whole_recording_here_are_meant_and_others_are_told(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = open_store(plant.service)
    whole = _kept(store, "FV-101", LONG_AGO)
    _kept(store, "FV-101", LONG_AGO, gateway="g2")
    _kept(store, "FV-101", LONG_AGO, recording_file=None, recording_sha256=None)
    _kept(store, "FV-101", LONG_AGO, state=RunState.STOPPED)
    cut_off = _kept(store, "FV-101", LONG_AGO, state=RunState.INTERRUPTED)
    gone = _kept(store, "FV-gone", LONG_AGO)
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        plan = body_of(await client.post("/reanalyses", json={**SINCE, "dry_run": True}))
        assert plan == {"tests": 3, "elsewhere": {"g2": 1}, "without_recording": 1, "queued_already": 0}
        begun = body_of(await client.post("/reanalyses", json=SINCE))
        assert begun["elsewhere"] == {"g2": 1}
        found = await _ended(client, begun["href"])
        assert (found["tests"]["completed"], found["tests"]["skipped"]) == (2, 1)
        assert (found["troubles"][0]["test"], found["troubles"][0]["valve"]) == (gone.id, "FV-gone")
        for run in (whole, cut_off):
            assert body_of(await client.get(f"/tests/{run.id}"))["analysis"]["repeated"]["by"] == "local"
        older = {**SINCE, "older_only": True, "dry_run": True}
        assert body_of(await client.post("/reanalyses", json=older))["tests"] == 1  # that of the valve that is gone


@contextmanager
def _service(plant_file: Path, duration_s: float, log: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-m", "tests.service.reanalysis_process", str(plant_file), str(duration_s), str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = next((line.strip() for line in process.stdout if line.startswith("http://")), "")
            assert url, "it ended before it listened"
            yield process, url
        finally:
            process.kill()


def _lines(log: Path, what: str) -> list[str]:
    text = log.read_text(encoding="utf-8") if log.exists() else ""
    return [line.split()[1] for line in text.splitlines() if line.startswith(what)]


@pytest.mark.parametrize("database_url", ["sqlite", pytest.param("postgresql", marks=pytest.mark.long)], indirect=True)
def test_a_killed_service_goes_on_with_what_is_left(quick_path: Path, plant_text: str, database_url: str) -> None:
    line = "" if database_url.startswith("sqlite") else f'database = "{database_url}"\n'
    _end_in_the_middle(quick_path, plant_text.replace("[service]\n", f"[service]\n{line}", 1), signal.SIGKILL)


@pytest.mark.long
def test_a_stopped_service_goes_on_with_what_is_left(quick_path: Path, plant_text: str) -> None:
    _end_in_the_middle(quick_path, plant_text, signal.SIGTERM)


def _end_in_the_middle(quick_path: Path, plant_text: str, end: signal.Signals) -> None:
    plant_file, log = quick_path / "plant.toml", quick_path / "log"
    plant_file.write_text(plant_text, encoding="utf-8")
    runs = _filled(load_plant(plant_file), 6)
    with _service(plant_file, 0.5, log) as (first, url):
        begun = httpx.post(f"{url}/reanalyses", json=SINCE, timeout=30.0).json()
        assert begun["total"] == 6
        ends_s = time.monotonic() + DEADLINE_S
        while len(_lines(log, "begun")) < 3:
            assert time.monotonic() < ends_s
            time.sleep(0.01)
        first.send_signal(end)
        assert first.wait(DEADLINE_S) == (-signal.SIGKILL if end is signal.SIGKILL else 0)
    with _service(plant_file, 0.01, log) as (second, url):
        answer = called("reanalyze", "--since", "2026-03-01", "--url", url, columns=200)
        found = httpx.get(f"{url}{begun['href']}", timeout=30.0).json()
        while found["state"] == "running":
            assert time.monotonic() < ends_s
            found = httpx.get(f"{url}{begun['href']}", timeout=30.0).json()
        assert (found["state"], found["tests"]["completed"]) == ("ended", 6)
        tests = [httpx.get(f"{url}/tests/{run.id}", timeout=30.0).json() for run in runs]
        second.send_signal(signal.SIGTERM)
        second.wait(DEADLINE_S)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert [test["state"] for test in tests] == ["completed"] * 6
    assert all(test["analysis"]["repeated"] for test in tests)
    if f"re-analysis {begun['number']}, " in answer.stdout:  # it had not ended when the command came
        assert sorted(_lines(log, "ended")) == sorted(run.id for run in runs), "none twice, none lost"
        assert len(_lines(log, "begun")) == 7, "one was cut off"


def test_the_command_shows_what_became_of_it_and_refuses_what_it_cannot_read(quick_path: Path, plant_text: str) -> None:
    plant_file, log = quick_path / "plant.toml", quick_path / "log"
    plant_file.write_text(plant_text, encoding="utf-8")
    _filled(load_plant(plant_file), 2)
    with _service(plant_file, 0.01, log) as (process, url):
        at = ("--url", url)
        dry = called("reanalyze", "--since", "2026-03-01", "--dry-run", *at)
        assert (dry.returncode, dry.stdout) == (0, "2 tests would be analysed anew; nothing was changed\n")
        done = called("reanalyze", "--since", "2026-03-01", "--valve", "FV-101", *at)
        assert (done.returncode, done.stdout.split(": ")[1]) == (0, "1 tests, 1 completed\n"), done
        for arguments, code, words in (
            (("--since", "yesterday"), 2, "no date"),
            (("--since", "2999-01-01"), 1, "is in the future"),
            (("--since", "2026-03-01", "--valve", "FV-999"), 1, "is unknown"),
            (("--since", "2026-03-02"), 1, "give an earlier since"),
            ((), 2, "--since DATE"),
            (("--stop", "7"), 1, "is unknown"),
        ):
            answer = called("reanalyze", *arguments, *at, columns=200)
            assert (answer.returncode, words in answer.stderr) == (code, True), answer
        process.send_signal(signal.SIGTERM)
        process.wait(DEADLINE_S)
        lost = called("reanalyze", "--since", "2026-03-01", *at, columns=200)
        assert (lost.returncode, "start it by breakaway serve" in lost.stderr) == (1, True)
