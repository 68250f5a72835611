"""An analysis that the end of a service broke off is made again at the next start; nothing moves for it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.runs.run import Run, RunState
from service.runs.second_analysis import BROKEN_OFF_KEY
from service.runs.service import Runs
from service.schedules.check import Check, CheckState
from service.settings import Plant
from service.store.store import Store
from tests.service.fake_rig import FakeAnalyst, FakeRig
from tests.service.nights import Clock, night, night_plant, until
from tests.service.stored_runs import stored
from valve.recording import Recording

WISH = {"sequence": "sine", "overrides": {"period_s": 5.0}}


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    store = Store(plant.service.store)
    yield store
    store.close()


def _runs(plant: Plant, store: Store, rig: FakeRig, analyst: Any = None) -> Runs:
    return Runs(plant, store, rig, analyst or FakeAnalyst(), software="breakaway 0")


def _analyzing(store: Store, **changes: Any) -> Run:
    """Return the run of a dead process that had begun to analyse a whole recording."""
    time_s = np.linspace(0.0, 10.0, 200)
    run = stored(RunState.ANALYZING)
    name, sha256 = store.write_recording(run.id, Recording(time_s, 1e-3 * time_s, command_pa=1e3 * time_s))
    kept: dict[str, Any] = {"recording_file": name, "recording_sha256": sha256, "safe_confirmed": True}
    return store.runs.insert(replace(run, **{**kept, "quality": {"ended": "completed"}, **changes}))


async def test_an_analysis_that_a_stop_broke_off_is_made_at_the_next_start_and_nothing_moves(
    plant: Plant, store: Store
) -> None:
    analyst = FakeAnalyst()
    analyst.let_go.clear()
    first = _runs(plant, store, FakeRig(), analyst)
    run = await first.start("FV-101", "triangle", {})
    await first.rest(run.id)
    async with asyncio.timeout(10.0):
        while not analyst.asked:  # noqa: ASYNC110  - a fake sets no event
            await asyncio.sleep(0.005)
    await first.shut_down(timeout_s=0.05)
    broken = store.runs.get(run.id)
    assert broken.state is RunState.ANALYZING
    rig = FakeRig()
    second = _runs(plant, store, rig)
    await second.recover()
    ended = await second.wait(run.id, 10.0)
    assert (ended.state, ended.error, ended.safe_confirmed) == (RunState.COMPLETED, "", True)
    assert store.runs.get(run.id).analysis == ended.analysis
    assert (ended.analysis or {})["recording"] == {"samples": 200}
    assert ended.quality == {**(broken.quality or {}), BROKEN_OFF_KEY: 1}
    assert (ended.motion_ended_at, ended.recording_sha256) == (broken.motion_ended_at, broken.recording_sha256)
    assert (rig.orders, rig.safe_calls) == ([], [])
    kinds = [event.kind async for events in await second.follow(run.id, 0) for event in events]
    assert kinds[-1] == "end"
    await second.shut_down()


@pytest.mark.parametrize(
    "lacks",
    [
        {"quality": {"ended": "completed", BROKEN_OFF_KEY: 3}},
        {"recording_file": None, "recording_sha256": None},
        {"safe_confirmed": None},
        {"valve": "FV-999"},
        {"sequence": "separating"},
    ],
    ids=["broken off thrice", "no recording", "not seen safe", "no such valve", "nothing to separate"],
)
async def test_what_lacks_more_than_its_analysis_is_interrupted(
    plant: Plant, store: Store, lacks: dict[str, Any]
) -> None:
    run = _analyzing(store, **lacks)
    runs = _runs(plant, store, FakeRig())
    await runs.recover()
    await runs.settled()
    assert store.runs.get(run.id).state is RunState.INTERRUPTED
    await runs.shut_down()


@pytest.mark.parametrize("is_later", [False, True])
async def test_a_separating_test_is_analysed_with_the_test_that_asked_for_it(
    plant: Plant, store: Store, is_later: bool
) -> None:
    asking = {"state": RunState.COMPLETED, "analysis": {"discrepancy": {"separating_test": WISH}}}
    asked = _analyzing(store, **asking)
    run = _analyzing(store, sequence="separating")
    if is_later:  # completed while this one was analysed: it asks for another test
        _analyzing(store, **asking)
    analyst = FakeAnalyst()
    runs = _runs(plant, store, FakeRig(), analyst)
    await runs.recover()
    await runs.settled()
    ended = store.runs.get(run.id)
    if is_later:
        assert (ended.state, analyst.asked) == (RunState.INTERRUPTED, [])
    else:
        assert (ended.analysis or {})["together"] == {"sequence": "sine", "tests": [asked.id]}
        assert analyst.asked[0][0] == (store.recording_path(asked.id),)
    await runs.shut_down()


async def test_an_analysis_that_fails_again_ends_the_test(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, rest = _analyzing(store), _analyzing(store)
    analyst, save = FakeAnalyst(), type(store.runs).save

    async def broken(*_: Any, **__: Any) -> Any:
        raise RuntimeError("a fault of ours")

    def full(self: Any, changed: Run) -> None:
        if changed.id == rest.id:
            raise OSError(28, "No space left on device")
        save(self, changed)

    monkeypatch.setattr(analyst, "analyze", broken)
    monkeypatch.setattr(type(store.runs), "save", full)
    runs = _runs(plant, store, FakeRig(), analyst)
    await runs.recover()
    ended = [await runs.wait(one.id, 10.0) for one in (run, rest)]
    assert [one.state for one in ended] == [RunState.FAILED, RunState.FAILED]
    assert "analysis failed: RuntimeError: a fault of ours" in ended[0].error
    assert store.runs.get(run.id) == ended[0]
    assert store.runs.get(rest.id).state is RunState.ANALYZING, "the next start finds it"
    await runs.shut_down()


async def test_a_nightly_check_ends_with_its_test_that_is_analysed_again(quick_path: Path) -> None:
    due = datetime(2026, 7, 1, 0, 30, tzinfo=UTC)
    plant, store, clock = night_plant(quick_path), Store(quick_path / "s"), Clock(due + timedelta(hours=2))
    store.schedule_runs.insert(Check("nightly", "2026-07-01T02:30", "A1", due, 3600.0, "triangle", "a"))
    check = store.schedule_runs.latest("nightly")[0]
    assert store.schedule_runs.take_up(check.id, "the dead process", due)
    run = _analyzing(store, valve="A1", idempotency_key=check.key)
    rig = FakeRig()
    async with night(plant, store, rig, clock):
        checks = await until(store, lambda found: any(one.state.ended for one in found if one.id == check.id))
    ended = next(one for one in checks if one.id == check.id)
    assert (ended.state, ended.reason, ended.test_id) == (CheckState.COMPLETED, "", run.id)
    assert "A1" not in [order.valve.nameplate.tag for order in rig.orders]
    store.close()
