from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from service.config.settings import load_plant
from service.model.check import Check, CheckState
from service.model.run import Run, RunState, new_run_id
from service.store.store import Store
from tests.service.nights import NIGHTLY, Clock, night, night_plant, plant_text, until
from tests.support.fake_rig import FakeRig
from tests.support.nominal_recordings import triangle_test
from valve.errors import BusyError, PermissiveError

BEFORE = datetime(2026, 6, 30, 12, 0, tzinfo=UTC)
DUE = datetime(2026, 7, 1, 0, 30, tzinfo=UTC)  # 02:30 in Berlin


def _all_ended(checks: list[Check], count: int = 3) -> bool:
    return len(checks) == count and all(check.state.ended for check in checks)


async def test_at_its_time_every_valve_is_checked_one_at_a_time_on_a_bus_and_buses_at_once(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(10.0), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, runs):
        await nightly.look()
        assert rig.orders == []
        clock.now = DUE + timedelta(seconds=20)
        nightly.look_now()
        await until(store, lambda _: len(rig.orders) == 2)
        assert {order.tag for order in rig.orders} == {"A1", "B1"}
        rig.duration_s = 0.3
        checks = await until(store, _all_ended)
        assert [check.state for check in checks] == [CheckState.COMPLETED] * 3
        tests = {check.valve: await runs.get(str(check.test_id)) for check in checks}
    assert {run.schedule for run in tests.values()} == {"nightly"}
    assert {run.requested_by for run in tests.values()} == {"schedule nightly"}

    def motion(tag: str) -> tuple[datetime, datetime]:
        started, ended = tests[tag].started_at, tests[tag].motion_ended_at
        assert started is not None
        assert ended is not None
        return started, ended

    assert motion("A2")[0] >= motion("A1")[1]
    assert motion("B1")[0] < motion("A1")[1]
    store.close()


async def test_a_doubled_firing_checks_each_valve_once(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, _):
        clock.now = DUE
        await asyncio.gather(*(nightly.look() for _ in range(5)))
        await until(store, _all_ended)
        clock.now = DUE - timedelta(hours=1)  # somebody sets the wall clock back, and the hour comes again
        await nightly.look()
        clock.now = DUE + timedelta(seconds=5)
        await nightly.look()
        assert len(await until(store, _all_ended)) == 3
    assert len(rig.orders) == 3
    store.close()


async def test_the_hour_that_comes_twice_checks_each_valve_once(quick_path: Path) -> None:
    before = datetime(2026, 10, 24, 23, 0, tzinfo=UTC)
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(before)
    async with night(plant, store, rig, clock) as (nightly, _):
        for minutes in range(0, 240, 10):
            clock.now = before + timedelta(minutes=minutes)
            await nightly.look()
            await until(store, lambda checks: all(check.state.ended for check in checks))
    checks = store.schedule_runs.latest("nightly")
    assert [check.occurrence for check in checks] == ["2026-10-25T02:30"] * 3
    assert len(rig.orders) == 3
    store.close()


async def test_a_night_without_a_service_is_written_down_and_nothing_moves(quick_path: Path) -> None:
    plant, store, rig = night_plant(quick_path), Store(quick_path / "s"), FakeRig()
    async with night(plant, store, rig, Clock(BEFORE)) as (nightly, _):
        pass
    assert store.schedule_runs.latest("nightly") == []
    first = Clock(DUE)
    async with night(plant, store, rig, Clock(BEFORE)) as (nightly, _):
        nightly._clock = first
        await nightly.look()
        await until(store, _all_ended)
    later = Clock(DUE + timedelta(days=2, hours=2))  # two nights on, an hour after the second window
    async with night(plant, store, rig, later) as (nightly, _):
        await nightly.look()
        checks = await until(store, lambda found: _all_ended(found, 9))
    missed = [check for check in checks if check.state is CheckState.SKIPPED]
    assert len(missed) == 6
    assert all("no service looked at the clock" in check.reason for check in missed)
    assert len(rig.orders) == 3
    store.close()


async def test_a_start_within_the_window_may_be_late(quick_path: Path) -> None:
    plant, store, rig = night_plant(quick_path), Store(quick_path / "s"), FakeRig()
    async with night(plant, store, rig, Clock(BEFORE)) as (nightly, _):
        nightly._clock = Clock(DUE)
        await nightly.look()
        await until(store, _all_ended)
    async with night(plant, store, rig, Clock(DUE + timedelta(days=1, minutes=50))) as (nightly, _):
        await nightly.look()
        checks = await until(store, lambda found: _all_ended(found, 6))
    assert {check.state for check in checks} == {CheckState.COMPLETED}
    store.close()


async def test_a_check_whose_turn_comes_after_the_window_is_skipped_with_the_reason(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(30.0), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, runs):
        long = await runs.start("A1", "triangle", {})
        clock.now = DUE
        await nightly.look()
        await until(store, lambda found: any(check.state is CheckState.RUNNING for check in found))
        clock.now = DUE + timedelta(seconds=3601)
        checks = await until(store, lambda found: sum(check.state.ended for check in found) == 2)
        skipped = [check for check in checks if check.state is CheckState.SKIPPED]
        assert {check.valve for check in skipped} == {"A1", "A2"}
        assert all(f"used by test {long.id}" in c.reason or f"test {long.id} uses" in c.reason for c in skipped)
        assert "window of 3600 s ended at " in skipped[0].reason
    store.close()


async def test_somebody_who_waits_goes_before_the_next_check_of_the_night(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(10.0), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, runs):
        clock.now = DUE
        await nightly.look()
        await until(store, lambda found: any(c.valve == "A1" and c.test_id for c in found))
        with pytest.raises(BusyError, match="leave the bus to you"):
            await runs.start("A2", "triangle", {})
        rig.duration_s = 0.3
        await until(store, lambda found: any(c.valve == "A1" and c.state.ended for c in found))
        await asyncio.sleep(0.3)  # the next check would have begun by now
        assert store.schedule_runs.latest("nightly")[1].state is CheckState.QUEUED
        mine = await runs.start("A2", "triangle", {})
        checks = await until(store, _all_ended)
        assert {check.state for check in checks} == {CheckState.COMPLETED}
        order = sorted((run for run in store.runs.newest(9) if run.valve == "A2"), key=lambda run: run.number)
        assert order[0].id == mine.id
    store.close()


async def test_a_missing_permissive_skips_the_valve_and_says_which(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, runs):
        begin = runs.start

        async def start(tag: str, *rest: object, **more: object) -> Run:
            if tag == "A1":
                raise PermissiveError("A1: the loop is in automatic: put it in manual")
            return await begin(tag, *rest, **more)  # type: ignore[arg-type]

        monkeypatch.setattr(runs, "start", start)
        clock.now = DUE
        await nightly.look()
        checks = {check.valve: check for check in await until(store, _all_ended)}
    assert (checks["A1"].state, checks["A1"].reason) == (
        CheckState.SKIPPED,
        "A1: the loop is in automatic: put it in manual",
    )
    assert checks["A2"].state is CheckState.COMPLETED
    store.close()


async def test_what_a_dead_process_had_begun_is_interrupted_and_what_waited_goes_on(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(DUE)
    for tag, bus in (("A1", "a"), ("A2", "a"), ("B1", "b")):
        store.schedule_runs.insert(Check("nightly", "2026-07-01T02:30", tag, DUE, 3600.0, "triangle", bus))
    cut_off = store.schedule_runs.latest("nightly")[0]
    assert store.schedule_runs.take_up(cut_off.id, "the dead process", DUE)
    key = f"nightly {cut_off.id} of nightly 2026-07-01T02:30"  # its test was stored, the check did not learn of it
    dead = Run(id=new_run_id(), valve="A1", sequence="triangle", state=RunState.RUNNING, idempotency_key=key)
    dead = store.runs.insert(dead)
    async with night(plant, store, rig, clock):
        checks = {check.valve: check for check in await until(store, _all_ended)}
    assert checks["A1"].state is CheckState.INTERRUPTED
    assert checks["A1"].test_id == dead.id
    assert rig.recoveries == [("A1", dead.number, None, False)], "it has no journal: nothing was commanded"
    assert sorted(order.tag for order in rig.orders) == ["A2", "B1"]
    store.close()


async def test_a_check_whose_test_lacks_nothing_but_its_analysis_ends_with_that(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(DUE)
    store.schedule_runs.insert(Check("nightly", "2026-07-01T02:30", "A1", DUE, 3600.0, "triangle", "a"))
    cut_off = store.schedule_runs.latest("nightly")[0]
    assert store.schedule_runs.take_up(cut_off.id, "the dead process", DUE)
    key = f"nightly {cut_off.id} of nightly 2026-07-01T02:30"
    dead = Run(id=new_run_id(), valve="A1", sequence="triangle", state=RunState.ANALYZING, idempotency_key=key)
    file, sha256 = store.write_recording(dead.id, triangle_test(0.01))
    dead = replace(dead, recording_file=file, recording_sha256=sha256, safe_confirmed=True, commanded=True)
    dead = store.runs.insert(dead)
    async with night(plant, store, rig, clock):
        (check,) = await until(store, lambda found: _all_ended(found, 1))
    assert (check.state, check.test_id) == (CheckState.COMPLETED, dead.id)
    assert store.runs.get(dead.id).state is RunState.COMPLETED
    assert (rig.orders, rig.safe_calls) == ([], [])
    store.close()


async def test_a_shutdown_leaves_what_waits_in_the_queue(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(30.0), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, _):
        clock.now = DUE
        await nightly.look()
        await until(store, lambda found: sum(check.test_id is not None for check in found) == 2)
    checks = {check.valve: check for check in store.schedule_runs.latest("nightly")}
    assert checks["A2"].state is CheckState.QUEUED
    assert checks["A1"].state is CheckState.FAILED
    assert "shut down" in checks["A1"].reason
    rig.duration_s = 0.05
    async with night(plant, store, rig, clock):
        done = {check.valve: check for check in await until(store, _all_ended)}
    assert done["A2"].state is CheckState.COMPLETED
    store.close()


async def test_a_check_that_plant_toml_no_longer_approves_is_not_carried_out(quick_path: Path) -> None:
    store, rig, clock = Store(quick_path / "s"), FakeRig(), Clock(DUE)
    for name, sequence in (("nightly", "sine"), ("gone", "triangle")):
        store.schedule_runs.insert(Check(name, "2026-07-01T02:30", "A1", DUE, 3600.0, sequence, "a"))
    async with night(night_plant(quick_path), store, rig, clock):
        checks = await until(store, lambda found: _all_ended(found, 2))
    assert {check.state for check in checks} == {CheckState.SKIPPED}
    assert rig.orders == []
    store.close()


async def test_a_check_asks_its_test_to_end_early_as_plant_toml_says_it_now(quick_path: Path) -> None:
    store, rig, clock = Store(quick_path / "s"), FakeRig(), Clock(DUE)
    path = quick_path / "plant.toml"
    schedule = NIGHTLY.replace("window_s", 'until = { F_s = "5 %" }\nwindow_s')
    polled = plant_text(schedule).replace('mode = "captured"', 'mode = "polled"').replace("= 0.001", "= 0.02")
    path.write_text(polled, encoding="utf-8")
    for tag, asked in (("A1", {"F_s": "5 %"}), ("B1", None)):
        bus = tag[0].lower()
        store.schedule_runs.insert(Check("nightly", "2026-07-01T02:30", tag, DUE, 3600.0, "triangle", bus, until=asked))
    async with night(load_plant(path), store, rig, clock):
        checks = {check.valve: check for check in await until(store, lambda found: _all_ended(found, 2))}
    assert (checks["A1"].state, checks["B1"].state) == (CheckState.COMPLETED, CheckState.SKIPPED)
    assert store.runs.get(str(checks["A1"].test_id)).until == {"F_s": "5 %"}
    assert "plant.toml asks for another test since" in checks["B1"].reason
    store.close()


async def test_a_valve_whose_last_check_has_not_ended_is_skipped(quick_path: Path) -> None:
    often = NIGHTLY.replace("30 2 * * *", "*/5 * * * *")
    plant, store, rig, clock = night_plant(quick_path, often), Store(quick_path / "s"), FakeRig(30.0), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, _):
        clock.now = BEFORE + timedelta(minutes=5)
        await nightly.look()
        clock.now = BEFORE + timedelta(minutes=10)
        await nightly.look()
        checks = await until(store, lambda found: len(found) == 6)
        assert [check.state for check in checks[3:]] == [CheckState.SKIPPED] * 3
        assert "2026-06-30T14:05 is still" in checks[3].reason
    store.close()


async def test_a_schedule_runs_by_hand_at_once(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(BEFORE)
    async with night(plant, store, rig, clock) as (nightly, _):
        queued = await nightly.run_now("nightly", "anna")
        assert [check.requested_by for check in queued] == ["anna"] * 3
        checks = await until(store, _all_ended)
    assert {check.state for check in checks} == {CheckState.COMPLETED}
    assert checks[0].occurrence == "2026-06-30T14:00:00 by hand"
    store.close()


async def test_a_failed_test_is_the_checks_failure_with_its_reason(quick_path: Path) -> None:
    plant, store, rig, clock = night_plant(quick_path), Store(quick_path / "s"), FakeRig(), Clock(BEFORE)
    rig.break_at = 0.5
    async with night(plant, store, rig, clock) as (nightly, _):
        clock.now = DUE
        await nightly.look()
        checks = await until(store, _all_ended)
    assert {check.state for check in checks} == {CheckState.FAILED}
    assert "the stem is stuck" in checks[0].reason
    assert replace(checks[0], state=CheckState.FAILED) == checks[0]
    store.close()
