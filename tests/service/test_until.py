"""Tests that tell what they know while they run, and that end once they know what was asked."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from drivers.motion.journal import JournalWriter
from drivers.outcome import PlayOutcome, SampleBlock
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.model.until import early_words, is_met, pairs_of, read_until
from service.report.of_run import _facts
from service.routes.run_views import view
from service.runs.live import LiveRun
from service.runs.live_estimates import EstimateWorker, LiveEstimates, turns_s
from service.runs.out_of_family import OutOfFamily
from service.runs.so_far import estimate_so_far
from service.store.store import Store, open_store
from service.words.reader import Reader
from tests.service.stored_runs import runs_of
from tests.support.fake_rig import FakeRig
from tests.support.rough_valves import RoughCase, case
from tests.support.running_service import running_service
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, wired_plant
from valve.errors import InternalError, RequestError
from valve.nameplate import Actuator, Nameplate
from valve.recording import Recording
from valve.recording_files import read_recording
from valve.waveform import multi_rate_triangle, steps, triangle

PLATE = Nameplate("FV-102", Actuator(0.1, 0.06))
WAVE = triangle(8.0, 3, 0.0, 80_000.0)  # turns at 4, 8, ... 20 s
KNOWN = {
    "status": "ok",
    "breakaways": 4,
    "parameters": {
        "k": {"value": 1.0e5, "ci95": [0.99e5, 1.01e5]},
        "F_c": {"value": 1000.0, "ci95": [985.0, 1015.0]},
        "F_s": {"value": 1200.0, "ci95": [1150.0, 1250.0]},
        "F_0": None,
    },
}
UNTIL = {"F_s": 5.0, "F_c": 2.0}


# ---- what is asked for


@pytest.mark.parametrize(
    ("until", "parts"),
    [
        ({"F_x": "5 %"}, ["until.F_x is unknown", "F_s, F_c, k"]),
        ({"F_0": "5 %"}, ["until.F_0 is unknown", "F_s, F_c, k"]),
        ({"F_s": 5}, ["until.F_s is '5'", "a percentage", '"5 %"']),
        ({"F_s": "5"}, ["until.F_s is '5'", "a percentage"]),
        ({"F_s": "five %"}, ["'five %'", "a percentage"]),
        ({"F_s": "nan %"}, ["'nan %'", "a percentage"]),
        ({"F_s": "5 %", "F_c": "0.4 %"}, ["until.F_c is 0.4 %", "at least 0.5 %"]),
        ({"F_s": "51%"}, ["until.F_s is 51 %", "at most 50 %"]),
        ({}, ["until is empty", "F_s, F_c, k"]),
    ],
)
async def test_a_wrong_until_is_refused_with_its_limit_and_remedy(
    client: httpx.AsyncClient, until: dict[str, Any], parts: list[str]
) -> None:
    answer = await client.post("/tests/run", json={"valve": "FV-102", "until": until})
    assert answer.status_code == 422
    assert all(part in answer.json()["detail"] for part in ["FV-102", *parts]), answer.json()["detail"]
    assert (await client.get("/tests")).json()["tests"] == []


async def test_a_test_that_its_device_plays_by_itself_takes_no_until(client: httpx.AsyncClient) -> None:
    answer = await client.post("/tests/run", json={"valve": "FV-101", "until": {"F_s": "5 %"}})
    assert answer.status_code == 422
    assert "acquisition.mode is captured" in answer.json()["detail"]
    assert "say acquisition.mode = polled" in answer.json()["detail"]


async def test_the_form_asks_for_it_where_the_valve_is_polled_alone(client: httpx.AsyncClient) -> None:
    assert 'data-symbol="F_s"' in (await client.get("/ui/valves/FV-102/start")).text
    assert "data-symbol" not in (await client.get("/ui/valves/FV-101/start")).text


async def test_a_separating_test_takes_no_until(client: httpx.AsyncClient) -> None:
    wanted = {"valve": "FV-102", "sequence": "separating", "until": {"F_s": "5 %"}}
    answer = await client.post("/tests/run", json=wanted)
    assert answer.status_code == 422
    assert "separating takes no until" in answer.json()["detail"]


async def test_a_key_that_was_used_with_another_until_is_refused(client: httpx.AsyncClient) -> None:
    headers = {"Idempotency-Key": "one", "Prefer": "wait=30"}
    wanted = {"valve": "FV-102", "until": {"F_s": "5 %"}}
    first = (await client.post("/tests/run", json=wanted, headers=headers)).json()
    assert first["state"] == "completed"
    assert (first["until"], first["ended_early"]) == ({"F_s": "5 %"}, None)
    same = await client.post("/tests/run", json={**wanted, "until": {"F_s": "5.0%"}}, headers=headers)
    assert same.json()["id"] == first["id"]
    other = await client.post("/tests/run", json={**wanted, "until": {"F_s": "6 %"}}, headers=headers)
    assert other.status_code == 422
    assert "another until" in other.json()["detail"]


class EarlyRig(FakeRig):
    """Ends a test after its first ramp up, as one that knew enough."""

    async def play(self, *said: Any) -> PlayOutcome:
        assert said[-1] is None  # nobody estimates here
        return replace(await super().play(*said), ended_early_s=4.0)


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    opened = open_store(plant.service)
    yield opened
    opened.close()


async def test_the_time_saved_is_kept_less_what_the_way_back_took_longer(plant: Plant, store: Store) -> None:
    runs, until = runs_of(plant, store, EarlyRig()), {"F_s": "5%", "F_c": "2.50 %"}
    span = {"low_pa": 10_000.0, "high_pa": 40_000.0}
    overrides = {"period_s": 8.0, "cycles": 3, **span}
    started = await runs.start("FV-102", "triangle", overrides, until=until)
    await runs.wait(started.id, 30.0)
    await runs.settled()
    rate = plant.valves["FV-102"].wiring.limits.pressure_rate_pa_per_s
    kept = store.runs.get(started.id)
    assert kept.state is RunState.COMPLETED
    assert kept.until == {"F_s": "5 %", "F_c": "2.5 %"}
    assert kept.ended_early == {"until": kept.until, "saved_s": round(20.0 - 30_000.0 / rate, 1)}
    shown = view(kept)
    assert shown.ended_early is not None
    assert shown.ended_early.saved_s < 20.0
    assert shown.until == kept.until
    (said,) = [words for name, words in dict(_facts(kept, None, Reader())).items() if name == "Until"]
    assert "ended early, as it knew F_s to 5 % and F_c to 2.5 %" in said
    again = await runs.analyze(kept.id)
    await runs.settled()
    assert store.runs.get(again.id).ended_early == kept.ended_early
    plain = await runs.start("FV-102", "triangle", overrides)
    await runs.settled()
    assert (store.runs.get(plain.id).until, store.runs.get(plain.id).ended_early) == (None, None)


def test_the_command_line_says_what_is_asked_as_a_request_does() -> None:
    assert pairs_of(["F_s=5%", "F_c = 2 %"]) == {"F_s": "5%", "F_c": "2 %"}
    assert read_until(TAG, pairs_of(["F_s=5%", "F_c = 2 %"])) == UNTIL
    assert pairs_of([]) is None
    with pytest.raises(RequestError, match=r"write it as SYMBOL=PERCENT: F_s=5%"):
        pairs_of(["F_s"])


@pytest.mark.parametrize(
    ("changed", "known"),
    [
        ({}, True),
        ({"breakaways": 3}, False),
        ({"status": "poor"}, False),
        ({"parameters": {**KNOWN["parameters"], "F_c": None}}, False),  # type: ignore[dict-item]
        ({"parameters": {**KNOWN["parameters"], "F_c": {"value": 1000.0, "ci95": [979.0, 1021.0]}}}, False),  # type: ignore[dict-item]
        ({"parameters": {**KNOWN["parameters"], "k": None}}, True),  # type: ignore[dict-item]
    ],
)
def test_a_test_knows_enough_by_four_breakaways_and_every_interval(changed: dict[str, Any], known: bool) -> None:
    assert is_met(UNTIL, {**KNOWN, **changed}) is known


def test_how_a_test_ended_is_said_in_words() -> None:
    until = {"F_s": "5 %", "F_c": "2 %"}
    assert early_words(None, None) == ""
    assert "knew F_s to 5 % and F_c to 2 %: 31 s were saved" in early_words(until, {"until": until, "saved_s": 31.2})
    assert "played its whole sequence" in early_words(until, None)


# ---- when it is looked at


def test_a_command_turns_where_the_ramp_before_ends() -> None:
    assert turns_s(WAVE) == (4.0, 8.0, 12.0, 16.0, 20.0)
    held = multi_rate_triangle([4.0, 2.0], 0.0, 1.0e4, turn_s=0.5)
    assert turns_s(held) == pytest.approx((2.0, 4.5, 6.0))
    assert turns_s(steps([0.0, 1.0, 2.0, 1.0], 1.0)) == (2.0,)


class FakeEstimator:
    """Answers when it is let go; ``error`` is raised once."""

    def __init__(self) -> None:
        self.asked = 0
        self.answer: dict[str, Any] | None = {**KNOWN, "time_s": 0.0, "family": None}
        self.error: Exception | None = None
        self.let_go = asyncio.Event()
        self.let_go.set()

    async def estimate(self, _journal: Path, _nameplate: Nameplate) -> dict[str, Any] | None:
        self.asked += 1
        await self.let_go.wait()
        error, self.error = self.error, None
        if error is not None:
            raise error
        return self.answer


class Bench:
    """The estimates of a test whose samples come as they are told."""

    def __init__(self, until: dict[str, str] | None) -> None:
        run = Run(id=new_run_id(), valve="FV-102", sequence="triangle", state=RunState.RUNNING, until=until)
        self.live, self.estimator = LiveRun(run), FakeEstimator()
        self.tasks: list[asyncio.Task[None]] = []
        self.of = LiveEstimates(
            self.live,
            WAVE,
            nameplate=PLATE,
            journal=Path("journal"),
            estimator=self.estimator,
            spawn=lambda work: self.tasks.append(asyncio.ensure_future(work)),
        )

    async def sample(self, time_s: float, **changes: Any) -> None:
        times_s = np.array([time_s])
        one = SampleBlock(times_s, 0.05 + 0.0 * times_s, times_s, times_s, times_s, times_s, recorded=True)
        self.of.samples(replace(one, **changes))
        for _ in range(5):
            await asyncio.sleep(0)

    def events(self, kind: str) -> list[Any]:
        return [event.data for event in self.live.events._events if event.kind == kind]


async def test_there_is_an_estimate_at_each_turning_point_and_at_least_every_5_s() -> None:
    bench = Bench(None)
    for time_s in np.arange(0.0, 4.0, 0.1):
        await bench.sample(time_s)
    assert bench.estimator.asked == 0
    await bench.sample(4.05)
    assert bench.estimator.asked == 1
    for time_s in (4.2, 6.0, 7.9):
        await bench.sample(time_s)
    assert bench.estimator.asked == 1
    await bench.sample(8.0)
    assert bench.estimator.asked == 2
    for time_s in (12.0, 16.0, 20.0, 22.0, 24.9, 25.1):
        await bench.sample(time_s)
    assert bench.estimator.asked == 6
    shown = bench.events("estimate")[0]
    assert shown == {"time_s": 0.0, "breakaways": 4, "parameters": KNOWN["parameters"]}
    assert not bench.of.enough.is_set()  # nothing was asked for


async def test_a_turning_point_during_an_estimate_is_looked_at_when_that_is_back() -> None:
    bench = Bench({"F_s": "5 %"})
    bench.estimator.let_go.clear()
    for time_s in (4.0, 5.0, 8.0, 9.5):
        await bench.sample(time_s)
    assert bench.estimator.asked == 1
    bench.estimator.answer = None
    bench.estimator.let_go.set()
    await bench.sample(9.6)
    bench.estimator.answer = {**KNOWN, "time_s": 9.7, "family": None}
    await bench.sample(9.7)
    assert bench.estimator.asked == 2
    assert bench.of.enough.is_set()


async def test_a_test_ends_at_a_turning_point_alone() -> None:
    bench = Bench({"F_s": "5 %", "F_c": "2 %"})
    bench.estimator.answer = {**KNOWN, "breakaways": 3, "time_s": 20.0, "family": None}
    await bench.sample(20.0)
    bench.estimator.answer = {**KNOWN, "time_s": 25.0, "family": None}
    await bench.sample(25.0)  # 5 s later, amid a ramp
    assert bench.estimator.asked == 2
    assert not bench.of.enough.is_set()


async def test_a_test_that_knows_enough_says_so_once() -> None:
    bench = Bench({"F_s": "5 %", "F_c": "2 %"})
    for time_s in (4.0, 8.0):
        await bench.sample(time_s)
    assert bench.of.enough.is_set()
    assert [one["kind"] for one in bench.events("notice")] == ["enough"]
    assert "F_s to 5 % and F_c to 2 %" in bench.events("notice")[0]["sentence"]


async def test_an_estimate_that_comes_after_the_sequence_changes_nothing() -> None:
    bench = Bench({"F_s": "5 %"})
    bench.estimator.let_go.clear()
    await bench.sample(4.0)
    bench.of.end()
    bench.estimator.let_go.set()
    await bench.sample(8.0)
    await asyncio.gather(*bench.tasks)
    assert (bench.estimator.asked, bench.events("estimate"), bench.of.enough.is_set()) == (1, [], False)


async def test_an_estimate_that_fails_leaves_the_test_alone() -> None:
    bench = Bench({"F_s": "5 %"})
    bench.estimator.error = InternalError("the worker ended")
    await bench.sample(4.0)
    assert bench.events("estimate") == []
    await bench.sample(8.0)
    assert bench.of.enough.is_set()


async def test_what_is_seen_of_a_device_that_plays_by_itself_is_no_sample() -> None:
    bench = Bench(None)
    await bench.sample(4.0, recorded=False, sent_s=None, received_s=None)
    assert bench.estimator.asked == 0


# ---- out of family


def _notices(one: RoughCase, change: Callable[[Any], Any] = lambda value: value) -> list[dict[str, Any]]:
    """What a watcher hears of a recording in blocks of 0.1 s, estimated at every tenth."""
    recording, found = one.recording, []
    assert recording.pressure_pa is not None
    assert recording.command_pa is not None
    pressure_pa = change(recording.pressure_pa)
    family = OutOfFamily(one.nameplate.actuator.travel_m)
    for number, row in enumerate(range(5, recording.samples - 5, 5)):
        if number % 50 == 49:
            so_far = Recording(recording.time_s[:row], recording.position_m[:row], pressure_pa=pressure_pa[:row])
            family.know(estimate_so_far(so_far, one.nameplate)["family"])
        rows = slice(row, row + 5)
        columns = {"time_s": recording.time_s[rows], "position_m": recording.position_m[rows]}
        block = SampleBlock(
            **columns,
            pressure_pa=pressure_pa[rows],
            command_pa=recording.command_pa[rows],
            sent_s=recording.time_s[rows],
            received_s=recording.time_s[rows],
            recorded=True,
        )
        notice = family.notice(block)
        found += [] if notice is None else [notice]
    return found


@pytest.mark.parametrize("valve", ["nominal", "rough", "graphite", "small", "large"])
def test_a_healthy_valve_is_never_out_of_family(valve: str) -> None:
    assert _notices(case(valve, "multi_rate", "usual", 0.02, seed=3)) == []


def test_a_breakaway_twice_the_last_one_is_noticed_while_the_stem_still_sticks() -> None:
    one = case("nominal", "triangle", "usual", 0.02, seed=3)
    time_s, area_m2 = one.recording.time_s, one.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    first = int(np.searchsorted(time_s, 43.0))  # on the third way up
    sticks = slice(first, first + 60)  # for 1.2 s the pressure rises and the stem stays

    def stuck(pressure_pa: Any) -> Any:
        changed = pressure_pa.copy()
        changed[sticks] += np.linspace(0.0, 2.0 * one.truth.parameters.static_friction_n / area_m2, 60)
        return changed

    (found,) = _notices(one, stuck)
    assert time_s[first] < found["time_s"] < time_s[first + 60]
    assert found["force_n"] > 2.0 * found["last_n"]
    assert found["last_n"] == pytest.approx(one.truth.parameters.static_friction_n, rel=0.15)
    assert "twice its last breakaway" in found["sentence"]


def test_a_stem_on_its_stop_is_not_out_of_family() -> None:
    family = OutOfFamily(0.1)
    known = {
        "area_m2": 0.06,
        "spring_n_per_m": 5.0e4,
        "preload_n": 0.0,
        "usual_n": 300.0,
        "last_n": 300.0,
        "breakaways": 4,
    }
    family.know({**known, "stops_m": [0.09]})
    times_s = np.arange(10.0)

    def block(position_m: float, moved_m: float = 0.0) -> SampleBlock:
        rising_pa = np.linspace(100_000.0, 110_000.0, 10)
        columns = (times_s, position_m + np.linspace(0.0, moved_m, 10), rising_pa, times_s)
        return SampleBlock(*columns, times_s, times_s, recorded=True)

    assert family.notice(block(0.05)) is None  # the first rows show no motion yet
    assert family.notice(block(0.0001)) is None
    assert family.notice(block(0.0899)) is None
    assert family.notice(block(0.0999)) is None
    assert family.notice(block(0.05, 0.01)) is None  # it slides
    assert family.notice(block(0.05)) is not None


# ---- the worker, and all of it


async def test_the_worker_estimates_what_a_journal_holds(quick_path: Path) -> None:
    one = case("nominal", "triangle", "usual", 0.02, seed=1)
    recording, journal = one.recording, quick_path / "test.journal"
    assert recording.pressure_pa is not None
    assert recording.command_pa is not None
    writer = JournalWriter(journal, {"test": "x"})
    columns = (recording.time_s, recording.position_m, recording.pressure_pa, recording.command_pa)
    writer.append(SampleBlock(*columns, recording.time_s, recording.time_s, recorded=True))
    writer.close()
    worker = EstimateWorker()
    try:
        found = await worker.estimate(journal, one.nameplate)
        missing = await worker.estimate(quick_path / "none.journal", one.nameplate)
    finally:
        await worker.close()
    assert missing is None
    assert found is not None
    assert found["status"] == "ok"
    assert found["breakaways"] >= 4
    truth = one.truth.parameters.by_symbol()
    for symbol in ("F_c", "F_s"):
        assert found["parameters"][symbol]["value"] == pytest.approx(truth[symbol], rel=0.05)


async def test_a_polled_test_ends_once_it_knows_what_was_asked(quick_path: Path) -> None:
    wanted = {
        "valve": TAG,
        "sequence": "triangle",
        "overrides": {"cycles": 12, "period_s": 4.0},  # 48 s
        "until": {"F_s": "10 %", "F_c": "10 %"},
    }
    async with wired_plant(quick_path, position_noise_m=1.0e-5) as (path, plant):
        async with running_service(load_plant(path), None, None) as client:
            asked = await client.post("/tests/run", json=wanted, headers={"Prefer": "wait=300"})
            body = asked.json()
            events = (await client.get(f"{body['href']}/events")).text
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
    assert body["state"] == "completed", body["error"]
    assert body["safe_confirmed"] is True
    assert body["until"] == {"F_s": "10 %", "F_c": "10 %"}
    recording = read_recording(quick_path / "plant-data" / "recordings" / f"{body['id']}.parquet")
    # the turning point after the fourth breakaway, or a later one; where a busy machine halts the ramp the stem rests
    assert 5.0 <= recording.duration_s < 40.0
    assert body["ended_early"]["until"] == body["until"]
    assert body["ended_early"]["saved_s"] == pytest.approx(48.0 - recording.duration_s, abs=2.0)
    assert body["ended_early"]["saved_s"] > 8.0
    values = {one["method"]: one["parameters"]["F_c"]["value"] for one in body["analysis"]["estimates"]}
    assert values["maximum_likelihood"] == pytest.approx(1423.0, rel=0.05)
    blocks = [dict(line.split(": ", 1) for line in one.split("\n")) for one in events.split("\n\n") if "event" in one]
    shown = [json.loads(one["data"]) for one in blocks if one["event"] == "estimate"]
    assert shown  # how many is a matter of the machine
    assert shown[-1]["breakaways"] >= 4
    assert any(json.loads(one["data"])["kind"] == "enough" for one in blocks if one["event"] == "notice")
