"""Analyses without a motion before them: taken up after a restart, and repeated on request."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.access.principal import Role
from service.audit.verify import entries_of
from service.cli.accounts import accounts
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.analysis import BEGUN_KEY, can_be_analysed
from service.model.run import Run, RunState
from service.runs.service import Runs
from service.store.store import Store
from tests.service.access.signed_in import body_of, signed_in
from tests.service.stored_runs import stored
from tests.service.test_report import name_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import motion_on
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.errors import BusyError, RecordingError

RUN = {"valve": "FV-101", "sequence": "triangle"}
WAIT = {"Prefer": "wait=20"}


class Failing(FakeAnalyst):
    """Fails as long as it shall."""

    def __init__(self) -> None:
        super().__init__()
        self.fails = True

    async def analyze(self, *args: Any, **more: Any) -> dict[str, Any]:
        if self.fails:
            raise RecordingError("a.parquet: it is not what it was")
        return await super().analyze(*args, **more)


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    store = Store(plant.service.store)
    yield store
    store.close()


async def ended(client: httpx.AsyncClient, address: str) -> Any:
    await client.get(f"{address}/events")  # it ends with the test
    return body_of(await client.get(address))


async def until_analysed(client: httpx.AsyncClient, address: str) -> None:
    async with asyncio.timeout(20.0):
        while body_of(await client.get(address))["state"] != "analyzing":  # noqa: ASYNC110  - it is looked at from outside
            await asyncio.sleep(0.02)


async def test_an_analysis_that_the_service_left_unfinished_is_taken_up_at_the_next_start(plant_file: Path) -> None:
    plant, rig, stuck = load_plant(plant_file), FakeRig(), FakeAnalyst()
    stuck.let_go.clear()
    async with running_service(plant, rig, stuck) as client:
        test = body_of(await client.post("/tests/run", json=RUN))
        await until_analysed(client, test["href"])
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 10.0, "nobody waits for what the next start does"
    analyst = FakeAnalyst()
    async with running_service(plant, rig, analyst) as client:
        body = await ended(client, test["href"])
        assert (body["state"], body["error"], body["safe_confirmed"]) == ("completed", "", True)
        assert body["analysis"]["recording"]["samples"] == 200
        assert body["analysis"]["repeated"]["by"] == "service"
        assert body["quality"].get(BEGUN_KEY) is None
        assert (len(rig.orders), rig.safe_calls, len(analyst.asked)) == (1, [], 1), "nothing moved again"


async def test_an_analysis_that_ended_the_service_three_times_is_left_alone(plant: Plant, store: Store) -> None:
    whole: dict[str, Any] = {"safe_confirmed": True, "recording_file": "x.parquet", "recording_sha256": "0"}
    runs = []
    for begun, there in ((2, True), (3, True), (0, False)):
        run = store.runs.insert(
            replace(stored(RunState.ANALYZING), quality={"ended": "completed", BEGUN_KEY: begun}, **whole)
        )
        if there:
            store.recording_path(run.id).touch()
        runs.append(run)
    service = Runs(plant, store, motion_on(plant, FakeRig(), folder=store.folder), Failing(), software="breakaway 0")
    await service.recover()
    await service.settled()
    states = [store.runs.get(run.id).state for run in runs]
    assert states == [RunState.FAILED, RunState.INTERRUPTED, RunState.INTERRUPTED]
    assert "not what it was" in store.runs.get(runs[0].id).error
    assert can_be_analysed(store.runs.get(runs[1].id)), "by somebody who asks for it"
    await service.shut_down()


async def test_a_test_whose_analysis_failed_is_analysed_again_on_request(plant_file: Path) -> None:
    name_plant(plant_file, "Mill 2", "Asia/Kolkata")
    plant, rig, analyst = load_plant(plant_file), FakeRig(), Failing()
    async with running_service(plant, rig, analyst) as client:
        test = body_of(await client.post("/tests/run", json=RUN, headers=WAIT))
        assert (test["state"], "not what it was" in test["error"]) == ("failed", True)
        page = (await client.get(f"/ui/tests/{test['id']}")).text
        assert "Analyse again" in page
        analyst.fails = False
        answer = await client.post(f"{test['href']}/analyze")
        assert (answer.status_code, answer.headers["location"]) == (202, test["href"])
        assert (answer.json()["state"], answer.json()["error"]) == ("analyzing", "")
        body = await ended(client, test["href"])
        assert (body["state"], body["error"]) == ("completed", "")
        metrics = (await client.get("/metrics")).text
        assert 'breakaway_tests{state="completed"} 1.0' in metrics
        assert 'breakaway_tests{state="failed"}' not in metrics or 'breakaway_tests{state="failed"} 0.0' in metrics
        assert body_of(await client.get("/valves/FV-101"))["last_result"]["id"] == test["id"]
        for address in (f"/ui/tests/{test['id']}", f"{test['href']}/report?format=html"):
            assert re.search(r"made again on [\d-]+ [\d:]+ IST by breakaway", (await client.get(address)).text), address
        assert len(rig.orders) == 1
    (log,) = (plant.service.store / "audit").iterdir()
    (entry,) = [one for one in entries_of(log) if one.event == "analysis.repeated"]
    assert (entry.who, entry.valve, entry.test, entry.details["was"]) == ("local", "FV-101", test["id"], "failed")


async def test_a_result_stands_until_there_is_a_new_one_and_where_that_fails(plant_file: Path) -> None:
    analyst = Failing()
    analyst.fails = False
    async with running_service(load_plant(plant_file), FakeRig(), analyst) as client:
        test = body_of(await client.post("/tests/run", json=RUN, headers=WAIT))
        first = test["analysis"]
        analyst.let_go.clear()
        assert body_of(await client.post(f"{test['href']}/analyze"))["analysis"] == first
        assert_problem(await client.post(f"{test['href']}/analyze"), 409, "analyzing")
        running = (await client.get(f"/ui/tests/{test['id']}")).text
        assert 'id="stop"' not in running, "nothing moves: there is nothing to stop"
        analyst.let_go.set()
        again = await ended(client, test["href"])
        assert again["analysis"].pop("repeated")["by"] == "local"
        assert again["analysis"] == first
        analyst.fails = True
        body_of(await client.post(f"{test['href']}/analyze"))
        kept = await ended(client, test["href"])
        assert (kept["state"], kept["analysis"]["recording"]) == ("completed", first["recording"])
        assert "the former result stands" in kept["error"]
        assert "the former result stands" in (await client.get(f"/ui/tests/{test['id']}")).text


@pytest.mark.parametrize("case", ["stopped", "unknown", "running", "gone", "not safe"])
async def test_what_is_no_whole_test_is_not_analysed(plant_file: Path, case: str) -> None:
    plant, rig = load_plant(plant_file), FakeRig(60.0 if case in ("stopped", "running") else 0.05)
    rig.safe_confirmed = case != "not safe"
    async with running_service(plant, rig, FakeAnalyst()) as client:
        test = body_of(await client.post("/tests/run", json=RUN, headers={} if rig.duration_s > 1.0 else WAIT))
        address = f"{test['href']}/analyze"
        if case == "unknown":
            assert_problem(await client.post("/tests/20260101T000000Z-00000000/analyze"), 404, "unknown")
            assert_problem(await client.post("/tests/x/analyze"), 404, "unknown")
        elif case == "running":
            await rig.moving.wait()
            assert_problem(await client.post(address), 409, "running", "repeat the request later")
        elif case == "gone":
            (plant.service.store / "recordings" / f"{test['id']}.parquet").unlink()
            assert_problem(await client.post(address), 404, "no longer in the store")
            assert body_of(await client.get(test["href"]))["state"] == "completed"
        else:
            if case == "stopped":
                await rig.moving.wait()
                await asyncio.sleep(0.3)
                body_of(await client.post(f"{test['href']}/stop"))
            assert_problem(await client.post(address), 422, "no whole recording of a motion that ended well")
            assert "Analyse again" not in (await client.get(f"/ui/tests/{test['id']}")).text


async def test_who_may_run_tests_may_repeat_an_analysis(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        engineer = served.tokens[Role.ENGINEER]
        test = body_of(await served.client.post("/tests/run", json=RUN, headers={**engineer, **WAIT}))
        address = f"{test['href']}/analyze"
        with accounts(served.config) as (access, _):
            one_day = timedelta(days=1)
            _, secret = access.create_token("other", Role.OPERATOR, by="test", lasts=one_day, valves=["FV-102"])
        for headers in (served.tokens[Role.VIEWER], served.tokens[Role.SCHEDULER]):
            assert_problem(await served.client.post(address, headers=headers), 403)
        other = {"Authorization": f"Bearer {secret}"}
        assert_problem(await served.client.post(address, headers=other), 403, "FV-101")
        assert (await served.client.post(address, headers=served.tokens[Role.OPERATOR])).status_code == 202


@pytest.mark.parametrize("again", ["repeated", "taken up"])
async def test_a_separating_test_is_analysed_again_with_the_tests_that_it_separates(
    plant_file: Path, again: str
) -> None:
    plant, rig, analyst = load_plant(plant_file), FakeRig(), FakeAnalyst()
    analyst.discrepancy = {"verdict": "ambiguous", "separating_test": {"sequence": "sine", "overrides": {}}}
    async with running_service(plant, rig, analyst) as client:
        first = body_of(await client.post("/tests/run", json=RUN, headers=WAIT))
        if again == "taken up":
            analyst.let_go.clear()
            test = body_of(await client.post("/tests/run", json={**RUN, "sequence": "separating"}))
            await until_analysed(client, test["href"])
        else:
            test = body_of(await client.post("/tests/run", json={**RUN, "sequence": "separating"}, headers=WAIT))
            body_of(await client.post("/tests/run", json=RUN, headers=WAIT))  # newer than both
    analyst = FakeAnalyst()
    async with running_service(plant, rig, analyst) as client:
        if again == "repeated":
            body_of(await client.post(f"{test['href']}/analyze"))
        body = await ended(client, test["href"])
        assert body["state"] == "completed"
        assert body["analysis"]["together"] == {"sequence": "sine", "tests": [first["id"]]}
        ((together, *_),) = analyst.asked
        assert [path.stem for path in together] == [first["id"]]


async def test_two_who_ask_at_once_begin_one_analysis(plant: Plant, store: Store) -> None:
    analyst = FakeAnalyst()
    runs = Runs(plant, store, motion_on(plant, FakeRig(), folder=store.folder), analyst, software="breakaway 0")
    run = await runs.wait((await runs.start("FV-101", "triangle", {})).id, 20.0)
    analyst.let_go.clear()
    answers = await asyncio.gather(*(runs.analyze(run.id) for _ in range(5)), return_exceptions=True)
    assert sum(isinstance(one, Run) for one in answers) == 1
    assert sum(isinstance(one, BusyError) for one in answers) == 4
    analyst.let_go.set()
    await runs.settled()
    await runs.shut_down()


async def test_an_ending_service_lets_those_go_who_watch_an_analysis(plant: Plant, store: Store) -> None:
    analyst = FakeAnalyst()
    analyst.let_go.clear()
    runs = Runs(plant, store, motion_on(plant, FakeRig(), folder=store.folder), analyst, software="breakaway 0")
    run = await runs.start("FV-101", "triangle", {})
    stream = await runs.follow(run.id, 0)
    seen: list[str] = []

    async def watch() -> None:
        async for events in stream:
            seen.extend(str(event.data.get("state")) for event in events)

    watching = asyncio.create_task(watch())
    async with asyncio.timeout(20.0):
        while "analyzing" not in seen:  # noqa: ASYNC110  - it is looked at from outside
            await asyncio.sleep(0.01)
        runs.begin_shutdown()
        await watching
        await runs.shut_down()
    assert store.runs.get(run.id).state is RunState.ANALYZING
    assert "completed" not in seen
