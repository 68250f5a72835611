"""Days in service: read from a simulated valve, judged, stored, and shown beside tests without being taken for one."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alembic import command
from sqlalchemy import inspect, make_url

from drivers.motion.moved_windows import MovedWindows
from drivers.motion.program import FilePlant, Moved
from drivers.motion.watch_file import days_in
from drivers.motion.watching import Watching
from estimators.in_service.result import Scale
from estimators.in_service.watch import watched
from service.config.plant import Plant
from service.config.settings import load_plant
from service.health.staleness import Staleness
from service.model.health_figures import Figure
from service.model.watched_day import DayJudged, JudgedBy, WatchedDay
from service.schedules.watched import WatchedDays
from service.store.database import _config, _engine
from service.store.store import Store
from service.watching.day import judge_day
from service.workers.analysis_process import AnalysisProcess
from simulator.assembly import SimulatedPlant
from tests.estimators.in_service.records import AREA_M2, BREAKAWAY_PA, FRICTION_PA, PLATE, TRAVEL_M, record
from tests.service.command_line import called
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.processes import until
from tests.support.running_service import running_application
from tests.support.watched_days import DAY, JUDGED_BY, NOON, document, kept, said
from tests.support.watching import meanwhile
from tests.support.wired_plant import TAG, wired_plant
from valve.errors import InternalError, RecordingError
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS

WATCH = "[valves.watch]\nperiod_s = 0.02\n"


def controlled(plant: SimulatedPlant, speed: float) -> AbstractAsyncContextManager[None]:
    """Have a controller beside us move the valve: it ramps from output to output, 12 kPa/s of the valve's time."""

    async def drive() -> None:
        valve, outputs = plant.valves[TAG], itertools.cycle((78_000.0, 10_000.0, 70_000.0, 6_000.0, 74_000.0, 14_000.0))
        asked_pa = wanted_pa = 40_000.0
        while True:
            plant.look()
            if asked_pa == wanted_pa:
                wanted_pa = next(outputs)
            step_pa = 12_000.0 * speed * 0.02
            asked_pa += max(-step_pa, min(step_pa, wanted_pa - asked_pa))
            valve.ask(asked_pa)
            await asyncio.sleep(0.02)

    return meanwhile(drive())


async def test_what_was_read_of_a_simulated_valve_gives_its_friction_within_the_interval(quick_path: Path) -> None:
    speed = 2.0
    async with wired_plant(quick_path, more=WATCH, speed=speed, position_noise_m=2.0e-5) as (path, simulated):
        plant = load_plant(path)
        store = Store(plant.service.store)
        motion = app_motion(plant, store)
        running = asyncio.create_task(motion.run())
        async with controlled(simulated, speed):

            async def has_read() -> bool:
                return motion.slots[TAG].read >= 1200

            await until(has_read, 120.0, "24 s of a controller's work")
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
        assert simulated.records[TAG].events == ()
    stale = Staleness(plant)
    async with AnalysisProcess() as pool:
        days = WatchedDays(plant, store, stale, pool, "breakaway 0")
        assert await days.look(datetime.now(UTC)) == 0  # the day is not over
        assert await days.look(datetime.now(UTC) + timedelta(days=2)) == 1
        assert await days.look(datetime.now(UTC) + timedelta(days=2)) == 0  # each day once
    async with running_application(app_of(plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:
        body = (await client.get(f"/valves/{TAG}/watched")).json()
        (day,) = body["days"]
        assert (day["source"], day["reason"]) == ("watched", "")
        assert body["rules"] == {"period_s": 0.02, "begins": None, "ends": None, "keep_days": 7}
        friction = day["result"]["figures"]["friction"]
        truth = PARAMETER_SETS["nominal"].parameters
        assert friction["ci95"][0] <= truth.coulomb_friction_n <= friction["ci95"][1]
        assert friction["value"] == pytest.approx(truth.coulomb_friction_n, rel=0.1)
        assert day["result"]["figures"]["spring_rate"]["value"] == pytest.approx(truth.spring_rate_n_per_m, rel=0.05)
        trend = (await client.get(f"/valves/{TAG}/trend")).json()["trends"]
        (mean,) = (one for one in trend if one["name"] == "friction_mean_n")
        assert mean["points"] == []
        assert mean["watched"] == [{"day": day["day"], "value": friction["value"], "ci95": friction["ci95"]}]
        shown = (await client.get(f"/valves/{TAG}")).json()
        assert shown["last_watched"] == day
        assert shown["last_test"] is None
        assert shown["health"] is None  # what was watched is no verdict
        table = (await client.get(f"/valves/{TAG}/watched", params={"format": "csv"})).text.splitlines()
        assert table[0].startswith("day,began_at,ended_at,rows,moves,reason,friction,friction_low,friction_high")
        assert str(friction["value"]) in table[1]
        assert (await client.get(f"/valves/{TAG}/watched", params={"format": "csv", "days": 3})).status_code == 422
        assert (await client.get("/valves/XV-1/watched")).status_code == 404


def app_motion(plant: Plant, store: Store) -> Watching:
    wired = FilePlant(lambda: Moved(plant.buses, {tag: valve.wiring for tag, valve in plant.valves.items()}))
    return Watching(wired, plant.buses, store.folder / "watched", "breakaway 0")


# ---- judging


def rows(count: int, *, pressure: bool = True, command: bool = True, seed: int = 3) -> np.ndarray[Any, Any]:
    noise_m = 1.0e-5 * np.random.default_rng(seed).standard_normal(count)
    time_s = datetime(2026, 11, 21, 8, tzinfo=UTC).timestamp() + 0.1 * np.arange(count)
    absent = np.full(count, np.nan)
    return np.column_stack(
        (
            time_s,
            0.05 + noise_m,
            np.full(count, 4.0e4) if pressure else absent,
            np.full(count, 4.1e4) if command else absent,
        )
    )


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (rows(3000), "FV-101: the stem made 0 moves beyond"),
        (rows(30), "FV-101: 30 rows have a position and a signal, watching needs at least 60"),
        (rows(1), "FV-101: 1 rows were kept of the day, 2 are needed"),
        (rows(3000, pressure=False, command=False), "neither a pressure nor a command was read all day"),
    ],
)
def test_a_day_that_says_nothing_has_its_reason(
    quick_path: Path, plant: Plant, found: np.ndarray[Any, Any], said: str
) -> None:
    judged = judge_day(kept(quick_path, found), plant.valves["FV-101"].nameplate)
    assert judged.document is None
    assert said in judged.reason
    assert judged.rows == len(found)
    assert DayJudged.from_json(judged.to_json()) == judged


def test_what_is_kept_of_a_day_says_what_the_whole_day_would(quick_path: Path) -> None:
    made = record(2.0, 0.1)
    assert made.pressure_pa is not None
    whole = np.column_stack((made.time_s, made.position_m, made.pressure_pa, np.full(made.samples, np.nan)))
    rest = whole[:1].repeat(72_000, axis=0)  # two hours in which the loop does nothing
    rest[:, 0] = whole[-1, 0] + 0.1 * np.arange(1, 72_001)
    rest[:, 1:] = whole[-1, 1:]
    windows = MovedWindows(TRAVEL_M)
    parts = [windows.take(block) for block in np.array_split(np.concatenate((whole, rest)), 2880)]
    found = np.concatenate(parts)
    assert len(whole) <= len(found) < 1.05 * len(whole)  # the rest is not kept
    judged = judge_day(kept(quick_path, found), PLATE).document
    by_hand = watched(made, PLATE, Scale(TRAVEL_M, AREA_M2), subject="FV-7")
    assert judged is not None
    for name, truth_pa in (("friction", FRICTION_PA), ("breakaway", BREAKAWAY_PA)):
        figure = judged["figures"][name]
        assert figure["ci95"][0] <= truth_pa * AREA_M2 <= figure["ci95"][1], name
        assert figure["value"] == pytest.approx(by_hand.figures[name].value, rel=0.01)


def test_a_file_of_the_store_is_read_by_breakaway_watch(quick_path: Path) -> None:
    made = record(0.5, 0.1)
    assert made.pressure_pa is not None
    rows_of_store = np.column_stack((made.time_s + 1.0e9, made.position_m, made.pressure_pa, made.pressure_pa))
    path = kept(quick_path, rows_of_store)
    plate = quick_path / "fv-7.toml"
    actuator = f"diaphragm_area_m2 = {AREA_M2}\ntravel_m = {TRAVEL_M}\nbench_set_pa = [20.0e3, 100.0e3]\n"
    plate.write_text(f'tag = "FV-7"\n[actuator]\n{actuator}')
    said = called("watch", str(path), "--nameplate", str(plate), "--json", "-", folder=quick_path)
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout)["figures"]["friction"]
    assert found["ci95"][0] <= FRICTION_PA * AREA_M2 <= found["ci95"][1]
    bare = called("watch", str(path), folder=quick_path)
    assert bare.returncode == 0, bare.stderr
    assert "kPa" in bare.stdout
    path.write_bytes(b"nothing")
    broken = called("watch", str(path), folder=quick_path)
    assert (broken.returncode, broken.stdout) == (1, "")
    assert "it has no header of breakaway/watched/1" in broken.stderr


class FakeJudge:
    """Says the same of every day; ``refuse`` is raised instead."""

    def __init__(self) -> None:
        self.asked: list[Path] = []
        self.refuse: Exception | None = None

    async def judge_day(self, path: Path, nameplate: Nameplate) -> DayJudged:
        assert nameplate.tag in path.parent.name
        self.asked.append(path)
        if self.refuse is not None:
            raise self.refuse
        return DayJudged(9, NOON, NOON, document(1100.0))


async def test_a_night_is_judged_once_it_is_over_and_not_again(watched_plant: Plant) -> None:
    store = Store(watched_plant.service.store)
    judge = FakeJudge()
    days = WatchedDays(watched_plant, store, Staleness(watched_plant), judge, "breakaway 0")
    kept(store.folder / "watched", rows(100))
    ends = datetime(2026, 11, 22, 5, tzinfo=UTC)
    assert await days.look(ends) == 0
    assert await days.look(ends + timedelta(minutes=2)) == 1
    assert await days.look(ends + timedelta(days=1)) == 0
    assert len(judge.asked) == 1
    (found,) = store.watched.newest("FV-101", 5)
    assert (found.day, found.rows, found.software) == (DAY, 9, "breakaway 0")
    assert found.judged_by == JUDGED_BY
    assert found.figures == {"friction_mean_n": Figure(1100.0, (1070.0, 1130.0))}
    store.close()


async def test_a_file_that_cannot_be_read_is_said_and_a_worker_that_dies_is_asked_three_times(
    watched_plant: Plant,
) -> None:
    store = Store(watched_plant.service.store)
    judge = FakeJudge()
    days = WatchedDays(watched_plant, store, Staleness(watched_plant), judge, "breakaway 0")
    folder = store.folder / "watched"
    kept(folder, rows(100))
    judge.refuse = RecordingError("2026-11-21.watch: it has no header")
    assert await days.look(NOON) == 1
    assert store.watched.newest("FV-101", 1)[0].reason == "2026-11-21.watch: it has no header"
    kept(folder, rows(100), day=DAY - timedelta(days=1))
    judge.refuse = InternalError("analysis: the worker ended")
    assert [await days.look(NOON) for _ in range(4)] == [0, 0, 1, 0]
    store.close()


async def test_samples_of_a_valve_that_is_no_longer_watched_are_judged_and_go_after_a_week(plant: Plant) -> None:
    store = Store(plant.service.store)
    days = WatchedDays(plant, store, Staleness(plant), FakeJudge(), "breakaway 0")
    folder = store.folder / "watched"
    kept(folder, rows(100))
    later = datetime.now(UTC) + timedelta(minutes=2)
    assert await days.look(later) == 1
    assert await days.look(later + timedelta(days=7)) == 0
    assert len(days_in(folder, "FV-101")) == 1
    await days.look(later + timedelta(days=8))
    assert list(folder.iterdir()) == []
    assert len(store.watched.newest("FV-101", 5)) == 1
    store.close()


async def test_samples_of_a_valve_that_has_left_the_plant_file_go_after_a_week_and_never_at_once(
    watched_plant: Plant,
) -> None:
    store = Store(watched_plant.service.store)
    days = WatchedDays(watched_plant, store, Staleness(watched_plant), FakeJudge(), "breakaway 0")
    folder = store.folder / "watched"
    for tag in ("FV-101", "FV-9", "FV-" + "9" * 200):
        kept(folder, rows(100), tag)
    gone = kept(folder, rows(100), "FV-9", DAY - timedelta(days=80))  # its keep_days were many
    gone.with_name(f"{gone.name}.damaged").write_bytes(b"?")
    await days.look(NOON + timedelta(days=300))  # a clock that was far ahead
    for later in (0, 7):
        await days.look(NOON + timedelta(days=later))
        assert len(days_in(folder)) == 4
    await days.look(NOON + timedelta(days=8))
    assert [one.tag for one in days_in(folder)] == ["FV-101"]
    assert [home.name for home in folder.iterdir()] == ["FV-101"]
    store.close()


async def test_a_valve_that_comes_back_into_the_plant_file_keeps_its_samples(
    plant: Plant, watched_plant: Plant
) -> None:
    store = Store(plant.service.store)
    without, with_it = (
        WatchedDays(one, store, Staleness(one), FakeJudge(), "breakaway 0") for one in (plant, watched_plant)
    )
    folder = store.folder / "watched"
    kept(folder, rows(100))
    await without.look(NOON)
    await with_it.look(NOON + timedelta(days=6))
    await without.look(NOON + timedelta(days=9))
    assert len(days_in(folder, "FV-101")) == 1
    store.close()


# ---- the store


def test_days_are_kept_by_valve_and_a_day_that_is_judged_again_stands_in_its_place(
    quick_path: Path, database_url: str
) -> None:
    store = Store(quick_path, database_url)
    for back in range(4):
        store.watched.add(said(DAY - timedelta(days=back), 1000.0 + back), "")
    store.watched.add(said(DAY, None), "")
    store.watched.add(said(DAY, 900.0, valve="FV-102"), "")
    newest = store.watched.newest("FV-101", 2)
    assert [one.day for one in newest] == [DAY, DAY - timedelta(days=1)]
    assert newest[0].figures == {}
    assert newest[0] == said(DAY, None)
    assert store.watched.judged(["FV-101"], DAY - timedelta(days=2)) == {
        "FV-101": {DAY - timedelta(days=back) for back in range(3)}
    }
    frictions = store.watched.frictions(DAY - timedelta(days=2))
    assert [one.friction.value for one in frictions["FV-101"]] == [1002.0, 1001.0]
    assert [one.friction.value for one in frictions["FV-102"]] == [900.0]
    assert {one.driven_by for one in frictions["FV-101"]} == {"pressure"}
    assert {one.judged_by for one in frictions["FV-101"]} == {JUDGED_BY}
    store.close()


def test_the_table_comes_with_its_revision_and_goes_with_it(database_url: str) -> None:
    engine = _engine(make_url(database_url))
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0014")
    assert "watched_days" in inspect(engine).get_table_names()
    with engine.begin() as connection:
        command.downgrade(_config(connection), "0013")
    assert "watched_days" not in inspect(engine).get_table_names()
    engine.dispose()


def test_days_that_were_judged_before_nameplates_were_stored_learn_theirs_from_what_they_said(
    quick_path: Path, database_url: str
) -> None:
    store = Store(quick_path, database_url)
    whole = document(1100.0)
    whole["figures"]["friction_signal"] = {**whole["figures"]["friction"], "value": 1100.0 / 0.06452, "unit": "Pa"}
    whole["travel"] = {"unit": "m", "histogram": {"edges": np.linspace(0.0, 0.1016, 11).tolist()}}
    nothing = WatchedDay("FV-101", DAY - timedelta(days=2), NOON, NOON, 9, NOON, "x", None, "FV-101: 0 moves")
    for one in (replace(said(DAY, 1100.0), document=whole), said(DAY - timedelta(days=1), 1100.0), nothing):
        store.watched.add(replace(one, judged_by=JudgedBy()), "")
    with store.engine.begin() as connection:
        command.downgrade(_config(connection), "0014")
    with store.engine.begin() as connection:
        command.upgrade(_config(connection), "head")
    by = [one.judged_by for one in store.watched.newest("FV-101", 3)]
    assert by[0].is_like(JUDGED_BY)
    assert by[1:] == [JudgedBy(), JudgedBy()]  # of these nobody can say it
    store.close()
