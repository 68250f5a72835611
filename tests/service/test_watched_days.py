"""Days in service: read from a simulated valve, judged, stored, and shown beside tests without being taken for one."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alembic import command
from sqlalchemy import inspect, make_url

from drivers.motion.moved_windows import MovedWindows
from drivers.motion.program import FilePlant, Moved
from drivers.motion.watch_file import WatchFileWriter, day_of, days_in
from drivers.motion.watching import Watching
from estimators.in_service.result import Scale
from estimators.in_service.watch import watched
from service.config.settings import Plant, load_plant
from service.figures.trend import Trend, TrendPoint, trends_picture
from service.health.changes import ValveFacts
from service.health.staleness import Oldest, Staleness
from service.health.watched import friction_changed
from service.model.health_figures import Figure
from service.model.health_limits import HealthLimits
from service.model.watched_day import ChangedInService, DayJudged, FrictionInService, WatchedDay
from service.schedules.watched import WatchedDays
from service.store.database import _config, _engine
from service.store.store import Store
from service.watching.day import judge_day
from service.words.units import UnitSystem
from service.workers.analysis_pool import AnalysisPool
from simulator.assembly import SimulatedPlant
from tests.estimators.in_service.records import AREA_M2, BREAKAWAY_PA, FRICTION_PA, PLATE, TRAVEL_M, record
from tests.service.command_line import called
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.processes import until
from tests.support.running_service import running_application
from tests.support.wired_plant import TAG, wired_plant
from valve.errors import InternalError, RecordingError
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS

WATCH = "[valves.watch]\nperiod_s = 0.02\n"
DAY = date(2026, 11, 21)
NOON = datetime(2026, 11, 22, 12, tzinfo=UTC)


@asynccontextmanager
async def controlled(plant: SimulatedPlant, speed: float) -> AsyncIterator[None]:
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

    driving = asyncio.create_task(drive())
    try:
        yield
    finally:
        driving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await driving


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
    async with AnalysisPool() as pool:
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


def kept(folder: Path, found: np.ndarray[Any, Any], tag: str = "FV-101", day: date = DAY) -> Path:
    place = day_of(folder, tag, day)
    writer = WatchFileWriter(place, {})
    writer.append(found)
    writer.close()
    return place.path


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


def document(friction_n: float | None, half_n: float = 30.0) -> dict[str, Any]:
    ci95 = None if friction_n is None else [friction_n - half_n, friction_n + half_n]
    figure = {"value": friction_n, "unit": "N", "ci95": ci95, "scatter": None, "count": 9, "note": "few moves"}
    return {"schema": "breakaway/watch/1", "moves": 12, "figures": {"friction": figure}}


@pytest.fixture
def watched_plant(plant_file: Path, plant_text: str) -> Plant:
    watch = '[valves.watch]\nfrom = "22:00"\nuntil = "05:00"\n'
    text = plant_text.replace(
        '[valves.acquisition]\nmode = "captured"', f'{watch}[valves.acquisition]\nmode = "captured"'
    )
    plant_file.write_text(text.replace("[service]\n", '[service]\nzone = "UTC"\n'), encoding="utf-8")
    return load_plant(plant_file)


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
    assert await days.look(datetime(2026, 11, 28, 12, tzinfo=UTC)) == 0
    assert len(days_in(folder, "FV-101")) == 1
    await days.look(datetime(2026, 11, 29, 12, tzinfo=UTC))
    assert days_in(folder, "FV-101") == []
    assert len(store.watched.newest("FV-101", 5)) == 1
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
    assert store.watched.judged(["FV-101"])["FV-101"] == {DAY - timedelta(days=back) for back in range(4)}
    frictions = store.watched.frictions(DAY - timedelta(days=2))
    assert [one.friction.value for one in frictions["FV-101"]] == [1002.0, 1001.0]
    assert [one.friction.value for one in frictions["FV-102"]] == [900.0]
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


def said(day: date, friction_n: float | None, *, half_n: float = 30.0, valve: str = "FV-101") -> WatchedDay:
    return WatchedDay(valve, day, NOON, NOON, 10, NOON, "breakaway 0", document(friction_n, half_n))


# ---- the state

FACTS = ValveFacts(0.1, 80_000.0, 80_000.0)


def frictions(*values_n: float, half_n: float = 30.0) -> list[FrictionInService]:
    first = DAY - timedelta(days=len(values_n) - 1)
    return [
        FrictionInService(
            first + timedelta(days=place),
            Figure(value, (value - half_n, value + half_n)),
            NOON + timedelta(days=place - len(values_n) + 1),
        )
        for place, value in enumerate(values_n)
    ]


def test_friction_that_rises_in_service_is_a_reason_to_test() -> None:
    changed = friction_changed(frictions(1000, 1010, 990, 1200, 1400, 1420, 1390), DAY, HealthLimits(), FACTS)
    assert changed is not None
    assert changed.sentence == (
        "Friction in service has risen by 40 % since 2026-11-15, from 1000 N to 1400 N "
        "(watched, not tested; 25 % are allowed): test this valve."
    )
    assert changed.since == NOON - timedelta(days=1)  # the first day whose last three had a median beyond the limit
    fallen = friction_changed(frictions(1000, 1000, 1000, 500, 500, 500), DAY, HealthLimits(), FACTS)
    assert fallen is not None
    assert "fallen by 50 %" in fallen.sentence


@pytest.mark.parametrize(
    "days",
    [
        frictions(1000, 1000, 1400, 1400, 1400),  # too few days
        frictions(1000, 1010, 990, 1100, 1200, 1180),  # within what is allowed
        frictions(1000, 1000, 1000, 1400, 1400, 1400, half_n=400.0),  # within the intervals
        frictions(1000, 1000, 1000, 1000, 1400, 1000),  # one odd day
        [],
    ],
)
def test_friction_that_may_be_as_it_was_is_no_reason(days: list[FrictionInService]) -> None:
    assert friction_changed(days, DAY, HealthLimits(), FACTS) is None


def test_days_that_are_long_ago_say_nothing_of_today() -> None:
    risen = frictions(1000, 1000, 1000, 1400, 1400, 1400)
    assert friction_changed(risen, DAY + timedelta(days=10), HealthLimits(), FACTS)
    assert friction_changed(risen, DAY + timedelta(days=11), HealthLimits(), FACTS) is None


def test_what_days_in_service_say_holds_from_the_day_on_which_they_said_it(plant: Plant) -> None:
    stale, since = Staleness(plant), NOON
    stale.note_watched({"FV-101": ChangedInService("Friction in service has risen.", since)})
    before, after = (stale.oldest("FV-101", since + timedelta(hours=hours)) for hours in (-1, 1))
    assert before.state("N", since) == "N"
    assert after.state("N", since) == "M"
    assert stale.oldest("FV-102", since + timedelta(hours=1)).state("N", since) == "N"


@pytest.mark.parametrize(("tested", "shown"), [("N", "M"), ("C", "M"), ("M", "M"), ("S", "S"), ("F", "F"), (None, "M")])
def test_what_was_watched_asks_for_maintenance_at_most(tested: str | None, shown: str) -> None:
    oldest = Oldest(NOON - timedelta(days=35), "35 are allowed", "Friction in service has risen.")
    assert oldest.state(tested, NOON) == shown
    health = oldest.health({"ne107": tested, "reasons": ["as tested"]}, NOON, NOON)
    assert health is not None
    assert (health["ne107"], health["reasons"]) == (shown, ["Friction in service has risen.", "as tested"])
    assert health["watched"] is True


async def test_a_valve_whose_friction_rose_in_service_is_shown_so_everywhere(plant: Plant) -> None:
    store = Store(plant.service.store)
    today = datetime.now(UTC).date()
    for back, friction_n in enumerate((1400.0, 1410.0, 1390.0, 1000.0, 1000.0, 1000.0)):
        store.watched.add(said(today - timedelta(days=back), friction_n), "")
        store.watched.add(said(today - timedelta(days=back), 1000.0, valve="FV-102"), "")
    async with running_application(app_of(plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:

        async def is_noted() -> bool:
            return (await client.get("/valves/FV-101")).json()["health"] is not None

        await until(is_noted, 10.0, "the first look at days in service")
        health = (await client.get("/valves/FV-101")).json()["health"]
        assert health["ne107"] == "M"
        assert "risen by 40 %" in health["reasons"][0]
        assert (await client.get("/valves/FV-102")).json()["health"] is None
        listed = {one["tag"]: one["health"] for one in (await client.get("/valves")).json()["valves"]}
        assert listed["FV-101"] == health
        assert listed["FV-102"] is None
        asked = (await client.get("/valves", params={"ne107": "M"})).json()["valves"]
        assert [one["tag"] for one in asked] == ["FV-101"]
        assert (await client.get("/valves", params={"ne107": "M", "state": "completed"})).json()["valves"] == []
        assert 'breakaway_valve_ne107{state="M",valve="FV-101"} 1.0' in (await client.get("/metrics")).text
        assert "risen by 40 %" in (await client.get("/")).text
        assert "risen by 40 %" in (await client.get("/ui/valves/FV-101")).text


# ---- the page and the picture


def full(day: date, friction_n: float | None) -> WatchedDay:
    base = document(friction_n)
    unit = {"unit": "N/m", "value": 52_000.0, "ci95": [51_000.0, 53_000.0], "scatter": None, "count": 9, "note": ""}
    travel = {"unit": "m", "total": 0.5345, "cycles": 15}
    whole = {**base, "figures": {**base["figures"], "spring_rate": unit}, "travel": travel}
    return WatchedDay("FV-101", day, NOON - timedelta(hours=7), NOON, 10, NOON, "breakaway 0", whole)


async def test_the_page_shows_the_last_day_in_service_and_says_that_it_is_no_test(watched_plant: Plant) -> None:
    store = Store(watched_plant.service.store)
    async with running_application(app_of(watched_plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:
        page = (await client.get("/ui/valves/FV-101")).text
        assert "No day in service has been judged yet." in page
        assert "Read from 22:00 to 05:00, every 0.1 s." in page
        assert "trend.svg" not in page
        assert 'id="in-service"' not in (await client.get("/ui/valves/FV-102")).text
        store.watched.add(full(DAY, 1100.0), "")
        page = (await client.get("/ui/valves/FV-101")).text
        assert "Watched while its controller moved it, not tested. 2026-11-21" in page
        assert "1100 ± 30 N" in page
        assert "534.5 mm, 12 moves, 15 turns" in page
        picture = (await client.get("/ui/figures/valves/FV-101/trend.svg")).text
        assert "Open circles: days in service, watched and not tested." in " ".join(picture.split())
        store.watched.add(full(DAY, None), "")
        assert "<dd>not known: few moves</dd>" in (await client.get("/ui/valves/FV-101")).text
        nothing = WatchedDay("FV-101", DAY, NOON, NOON, 0, NOON, "x", None, "FV-101: the stem made 0 moves")
        store.watched.add(nothing, "")
        assert "FV-101: the stem made 0 moves." in (await client.get("/ui/valves/FV-101")).text


def test_days_in_service_are_drawn_apart_from_tests_and_change_no_line_between_them() -> None:
    tests = tuple(TrendPoint(NOON - timedelta(days=back), 600.0 + back, (590.0, 610.0)) for back in (9, 5, 1))
    days = tuple(TrendPoint(NOON - timedelta(days=back), 640.0, (600.0, 680.0)) for back in (3, 2))
    bare = trends_picture([Trend("friction_mean_n", "friction, mean", "N", tests)], UnitSystem.SI, UTC)
    both = trends_picture([Trend("friction_mean_n", "friction, mean", "N", tests, watched=days)], UnitSystem.SI, UTC)
    alone = trends_picture([Trend("friction_mean_n", "friction, mean", "N", (), watched=days)], UnitSystem.SI, UTC)
    assert bare is not None
    assert both is not None
    assert alone is not None
    assert "in service is 640 ± 40 N" in both.description
    assert "in service" not in bare.description
    lines = [line for line in both.figure.axes[0].lines if len(np.asarray(line.get_xdata())) == 3]
    assert [np.asarray(line.get_ydata()).tolist() for line in lines] == [[609.0, 605.0, 601.0]]
    hollow = [line for line in both.figure.axes[0].lines if line.get_markerfacecolor() == "none"]
    assert [np.asarray(line.get_ydata()).tolist() for line in hollow] == [[640.0], [640.0]]
