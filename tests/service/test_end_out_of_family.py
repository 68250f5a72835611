"""``limits.end_out_of_family``: a breakaway twice the last one ends a test by its usual ramp, and that is said."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from drivers.motion.orders import MotionEnd
from drivers.motion.spool import end_of_json, end_to_json
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from service.config.plant import Plant
from service.config.settings import load_plant
from service.health.assess import assess
from service.health.changes import ValveFacts
from service.health.results import Case, Ne107
from service.model.family_rule import event_words
from service.model.health_limits import HealthLimits
from service.model.run import Run, RunState, new_run_id
from service.model.until import early_words
from service.report.of_run import _facts
from service.routes.run_views import view
from service.runs.live import LiveRun
from service.runs.live_estimates import LiveEstimates
from service.words.reader import Reader
from simulator.assembly import SimulatedPlant
from simulator.faults import Fault, FaultKind
from simulator.sensor import Sensor
from tests.support.running_service import running_service
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, standing_valve, wired_plant
from valve.errors import ConfigurationError
from valve.nameplate import Actuator, Nameplate
from valve.recording_files import read_recording
from valve.waveform import triangle

ON = "longest_test_s = 300.0\nend_out_of_family = true"
OFF = "longest_test_s = 300.0"
EVENT = {"breakaway": 5, "time_s": 12.34, "force_n": 1260.0, "last_n": 600.0, "times": 2.1}
MOTION = {"period_s": 4.0, "cycles": 5, "low_pa": 15_000.0, "high_pa": 65_000.0}  # 20 s
NIGHTLY = f"""
[[schedules]]
name = "nightly"
cron = "30 2 * * *"
zone = "Europe/Berlin"
valves = ["{TAG}"]
sequence = "triangle"
window_s = 3600.0
[schedules.overrides]
""" + "\n".join(f"{key} = {value}" for key, value in MOTION.items())


# ---- the key of plant.toml


def _changed(path: Path, text: str, *changes: tuple[str, str]) -> Plant:
    for was, now in changes:
        assert was in text
        text = text.replace(was, now)
    path.write_text(text, encoding="utf-8")
    return load_plant(path)


POLLED = ('mode = "captured"', 'mode = "polled"')


def test_the_rule_is_off_by_default_and_a_valve_of_polled_tests_may_have_it(plant_file: Path, plant_text: str) -> None:
    assert {one.wiring.limits.end_out_of_family for one in load_plant(plant_file).valves.values()} == {False}
    plant = _changed(plant_file, plant_text, POLLED, (OFF, ON))
    assert {one.wiring.limits.end_out_of_family for one in plant.valves.values()} == {True}


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        (
            [POLLED, (OFF, f'{OFF}\nend_out_of_family = "yes"')],
            ['valves[0].limits.end_out_of_family = "yes"', "give true or false"],
        ),
        (
            [(OFF, ON)],
            ["valves[0].limits.end_out_of_family = true", TAG, "is captured", "say acquisition.mode = polled"],
        ),
        (
            [POLLED, (OFF, ON), ("diaphragm_area_m2 = 0.06452\n", "")],
            ["limits.end_out_of_family = true", TAG, "needs the force", "give actuator.diaphragm_area_m2"],
        ),
    ],
)
def test_a_rule_that_is_wrong_or_can_never_hold_is_refused_with_a_remedy(
    plant_file: Path, plant_text: str, changes: list[tuple[str, str]], parts: list[str]
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        _changed(plant_file, plant_text, *changes)
    line = next(one for one in str(caught.value).splitlines() if "end_out_of_family" in one)
    assert all(part in line for part in parts), line


# ---- while a test runs


class Bench:
    """The estimates of a test on whose stem the force rises to twice the last breakaway's."""

    def __init__(self, *, is_on: bool, joins: bool = False) -> None:
        self.asked = 0
        run = Run(new_run_id(), TAG, "triangle", state=RunState.RUNNING, until={"F_s": "5 %"})
        self.live = LiveRun(run)
        self.of = LiveEstimates(
            self.live,
            triangle(8.0, 3, 0.0, 80_000.0),
            nameplate=Nameplate(TAG, Actuator(0.1, 0.06)),
            journal=Path("journal"),
            estimator=self,
            spawn=self._spawn,
            ends_out_of_family=is_on,
            joins=joins,
        )
        family = {"area_m2": 0.06, "spring_n_per_m": 5.0e4, "preload_n": 0.0, "usual_n": 300.0, "last_n": 300.0}
        self.of._family.know({**family, "breakaways": 4, "stops_m": []})

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        self.asked += 1
        work.close()

    async def estimate(self, _journal: Path, _nameplate: Nameplate) -> dict[str, Any] | None:
        return None

    def stick(self, after_s: float = 1.0) -> None:
        times_s = after_s + np.linspace(0.0, 0.9, 10)
        rising_pa = np.linspace(48_000.0, 56_000.0, 10)  # 2500 N of spring at 0.05 m: from 380 N on
        block = SampleBlock(times_s, np.full(10, 0.05), rising_pa, rising_pa, times_s, times_s, recorded=True)
        self.of.samples(replace(block, time_s=times_s - 1.0, pressure_pa=np.full(10, 45_000.0)))
        self.of.samples(block)

    @property
    def notices(self) -> list[Any]:
        return [event.data for event in self.live.events._events if event.kind == "notice"]


async def test_a_breakaway_twice_the_last_one_ends_the_test_and_says_why() -> None:
    bench = Bench(is_on=True)
    bench.stick()
    assert bench.of.enough.is_set()
    told, why = bench.notices
    assert (told["kind"], why["kind"]) == ("breakaway", "out_of_family")
    assert bench.of.because == {name: why[name] for name in EVENT}
    assert why["breakaway"] == 5
    assert 2.0 <= why["times"] == why["force_n"] / 300.0 < 3.0
    assert "ends early by its limits: breakaway 5 took" in why["sentence"]
    bench.stick()
    assert [one["kind"] for one in bench.notices].count("out_of_family") == 1


async def test_without_the_rule_it_is_told_alone() -> None:
    bench = Bench(is_on=False)
    bench.stick()
    assert not bench.of.enough.is_set()
    assert [one["kind"] for one in bench.notices] == ["breakaway"]


async def test_on_the_last_ramp_nothing_happens() -> None:
    bench = Bench(is_on=True)
    bench.of.end()  # the sequence is over, and the valve on its way to its safe value
    bench.stick()
    assert (bench.of.enough.is_set(), bench.of.because, bench.notices) == (False, None, [])


async def test_a_test_that_knew_enough_before_keeps_that_reason() -> None:
    bench = Bench(is_on=True)
    bench.of.enough.set()
    bench.stick()
    assert bench.of.because is None
    assert [one["kind"] for one in bench.notices] == ["breakaway"]


async def test_a_service_that_comes_back_amid_a_test_follows_the_rule_and_judges_no_turn_that_is_past() -> None:
    bench = Bench(is_on=True, joins=True)
    bench.stick(after_s=12.5)
    assert (bench.of.enough.is_set(), bench.asked, bench.of._judged) == (True, 1, 3)


@pytest.mark.parametrize("early", [None, EVENT])
def test_the_reason_is_kept_with_the_end_of_the_motion(early: dict[str, float] | None) -> None:
    end = MotionEnd(PlayOutcome(None, Ended.COMPLETED, True, ended_early_s=4.0), early=early)
    said = json.loads(json.dumps(end_to_json(end)))
    assert end_of_json(said, None) == end
    del said["early"]  # of a motion process before there was a rule
    assert end_of_json(said, None).early is None


# ---- what is said of it


def _ended(until: dict[str, str] | None = None) -> Run:
    quality = {"ended_early": {"until": {}, "saved_s": 7.6, "out_of_family": EVENT}}
    return Run(new_run_id(), TAG, "triangle", state=RunState.COMPLETED, quality=quality, until=until)


def test_the_result_says_which_breakaway_ended_the_test() -> None:
    said = "ended early by its limits: breakaway 5 took 1260 N after 12.3 s, 2.1 times the 600 N of the last. 8 s were"
    for until in (None, {"F_s": "5 %"}):  # whatever it was to know, it did not
        run = _ended(until)
        assert said in early_words(run.until, run.ended_early)
        assert said in dict(_facts(run, None, Reader()))["Ended early"]
        shown = view(run).model_dump(mode="json")["ended_early"]
        assert shown == {"until": {}, "saved_s": 7.6, "out_of_family": EVENT}
    knew = replace(_ended(), quality={"ended_early": {"until": {"F_s": "5 %"}, "saved_s": 7.6}})
    assert view(knew).model_dump()["ended_early"]["out_of_family"] is None  # as tests before it are stored


def test_a_test_that_was_ended_so_asks_for_maintenance_and_is_no_baseline() -> None:
    analysis: dict[str, Any] = {"discrepancy": {"verdict": "none"}, "estimates": []}
    case = Case(analysis, _ended().created_at, ValveFacts(0.1, 80_000.0, 80_000.0), HealthLimits())
    cut, whole = assess(replace(case, out_of_family=EVENT)), assess(case)
    (found,) = [one for one in cut.findings if event_words(EVENT) in one.sentence]
    assert found.state is Ne107.MAINTENANCE
    assert not cut.is_accepted
    assert not [one for one in whole.findings if "breakaway 5" in one.sentence]


# ---- all of it, by the simulated valve


async def _events(client: httpx.AsyncClient, test_id: str) -> AsyncIterator[tuple[str, dict[str, Any]]]:
    async with client.stream("GET", f"/tests/{test_id}/events") as stream:
        kind = ""
        async for line in stream.aiter_lines():
            name, _, value = line.partition(": ")
            if name == "event":
                kind = value
            elif name == "data":
                yield kind, json.loads(value)


async def _check(client: httpx.AsyncClient) -> dict[str, Any]:
    """Return the check that was asked for by hand, else the one that the night plans."""
    night: list[dict[str, Any]] = (await client.get("/schedules/night")).json()
    return max(night, key=lambda one: one["state"] != "planned")


def _seize(plant: SimulatedPlant) -> None:
    """Hold the stem for 2.5 s: wherever in its cycle it stands, the force rises beyond twice a breakaway's."""
    plant.look()
    now_s = plant.clock.now_s()
    plant.inject(TAG, Fault(FaultKind.STUCK_STEM, now_s + 0.05, now_s + 2.55))


async def _played(client: httpx.AsyncClient, plant: SimulatedPlant, test_id: str) -> list[dict[str, Any]]:
    """Follow a test to its end, seize its stem after the fourth breakaway, and return its notices."""
    notices, seized = [], False
    async for kind, data in _events(client, test_id):
        if kind == "notice":
            notices.append(data)
        if kind == "estimate" and data["breakaways"] >= 4 and not seized:
            seized = True
            _seize(plant)
    assert seized
    return notices


def _light_valve() -> Any:
    """A valve of light packing, whose force can rise far beyond its breakaway within one ramp."""
    valve = standing_valve(SAFE_PA)
    light = replace(valve.parameters, coulomb_friction_n=500.0, static_friction_n=600.0)
    return replace(valve, parameters=light, position=Sensor((-0.005, 0.107), 1.0e-5))


async def test_a_nightly_check_whose_packing_seizes_ends_early_is_analysed_and_marked(quick_path: Path) -> None:
    async with wired_plant(quick_path, period_s=0.02, valve=_light_valve()) as (path, plant):
        served = _changed(path, path.read_text(encoding="utf-8") + NIGHTLY, (OFF, ON))
        async with running_service(served, None, None) as client, asyncio.timeout(600.0):
            assert (await client.post("/schedules/nightly/run")).status_code == 202
            while not (check := await _check(client))["test_id"]:
                pass
            test_id = check["test_id"]
            notices = await _played(client, plant, test_id)
            body = (await client.get(f"/tests/{test_id}")).json()
            page = (await client.get(f"/ui/tests/{test_id}")).text
            while (check := await _check(client))["state"] == "running":
                pass
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
    assert body["state"] == "completed", body["error"]
    assert body["safe_confirmed"] is True
    event = body["ended_early"]["out_of_family"]
    assert event["times"] >= 2.0
    assert event["breakaway"] >= 4
    assert event["last_n"] == pytest.approx(600.0, rel=0.2)
    recording = read_recording(quick_path / "plant-data" / "recordings" / f"{test_id}.parquet")
    assert event["time_s"] <= recording.duration_s < event["time_s"] + 2.0  # it ended soon, wherever in its ramp
    assert body["ended_early"]["saved_s"] == pytest.approx(20.0 - recording.duration_s, abs=2.0)
    assert body["analysis"]["estimates"]
    assert body["analysis"]["health"]["ne107"] in ("M", "S", "F")
    assert any("The test ended early: breakaway" in one for one in body["analysis"]["health"]["reasons"])
    assert [one["kind"] for one in notices][:2] == ["breakaway", "out_of_family"]
    assert 'id="ended-early">The test ended early by its limits: breakaway' in page
    assert check["state"] == "completed"
    assert "ended early by its limits: breakaway" in check["reason"]


@pytest.mark.long
async def test_without_the_rule_the_test_goes_on_to_its_end(quick_path: Path) -> None:
    async with (
        wired_plant(quick_path, valve=_light_valve()) as (path, plant),
        running_service(load_plant(path), None, None) as client,
        asyncio.timeout(600.0),
    ):
        wanted = {"valve": TAG, "sequence": "triangle", "overrides": MOTION}
        test_id = (await client.post("/tests/run", json=wanted)).json()["id"]
        notices = await _played(client, plant, test_id)
        body = (await client.get(f"/tests/{test_id}")).json()
    assert body["state"] == "completed", body["error"]
    assert body["ended_early"] is None
    assert "breakaway" in [one["kind"] for one in notices]
    assert "out_of_family" not in [one["kind"] for one in notices]
    recording = read_recording(quick_path / "plant-data" / "recordings" / f"{test_id}.parquet")
    assert recording.duration_s == pytest.approx(20.0, abs=0.2)
