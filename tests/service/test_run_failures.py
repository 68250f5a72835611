"""What becomes of a test when the process, the disk, the wire or the service ends."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.outcome import Ended, PlayOutcome, SampleBlock
from service.runs.live import MOTION_SHARE
from service.runs.recovery import keep_journals_of_ended_runs, mark_interrupted
from service.runs.rig import Order, Watcher
from service.runs.run import Run, RunState
from service.settings import Plant
from service.store.journal import JournalWriter
from service.store.run_table import RunTable
from service.store.store import Store
from tests.service.fake_rig import FakeRig
from tests.service.stored_runs import block, runs_of, stored
from valve.errors import PermissiveError


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    store = Store(plant.service.store)
    yield store
    store.close()


async def test_an_unfinished_test_is_interrupted_and_its_valve_is_sent_to_safe(plant: Plant, store: Store) -> None:
    states = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)
    left = [store.runs.insert(stored(state)) for state in states]
    store.runs.save(replace(left[2], safe_confirmed=True))
    journal = JournalWriter(store.journal_path(left[1].id), {"valve": "FV-101", "entry_pa": 777.0})
    journal.append(block(50))
    journal.close()
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    after = [store.runs.get(run.id) for run in left]
    assert {run.state for run in after} == {RunState.INTERRUPTED}
    assert sorted(rig.safe_calls, key=str) == [("FV-101", 1, None), ("FV-101", 2, 777.0)]
    assert [run.safe_confirmed for run in after] == [True, True, True]
    assert after[1].recording_file is not None
    assert not store.journal_path(left[1].id).exists()
    assert rig.orders == [], "nothing resumes by itself"


async def test_a_valve_that_cannot_be_made_safe_after_a_crash_is_said_so(plant: Plant, store: Store) -> None:
    gone = store.runs.insert(replace(stored(RunState.RUNNING), valve="FV-999"))
    here = store.runs.insert(stored(RunState.RUNNING))
    rig = FakeRig()
    rig.safe_confirmed = False
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    for run in (gone, here):
        assert store.runs.get(run.id).safe_confirmed is False
        assert "SAFE STATE NOT CONFIRMED" in store.runs.get(run.id).error


async def test_a_disk_that_fails_stops_the_test_and_keeps_what_was_written(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig(1.0)
    runs = runs_of(plant, store, rig)
    write, calls = JournalWriter.append, 0

    def failing(self: JournalWriter, block: SampleBlock) -> None:
        nonlocal calls
        calls += 1
        if calls > 3:
            raise OSError(28, "No space left on device")
        write(self, block)

    def no_room(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(JournalWriter, "append", failing)
    monkeypatch.setattr(Path, "replace", no_room)  # as every file is written: whole, then given its name
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert ended.state is RunState.FAILED
    assert "No space left on device): look at its disk" in ended.error
    assert "samples can no longer be written (No space left on device): the test was stopped" in ended.error
    assert "report it" not in ended.error
    assert store.journal_path(run.id).exists()
    monkeypatch.undo()
    keep_journals_of_ended_runs(store)
    kept = store.runs.get(run.id)
    assert kept.recording_sha256 is not None
    assert kept.state is RunState.FAILED
    await runs.shut_down()


async def test_a_bad_end_that_the_store_could_not_take_bars_the_next_test_once_there_is_room(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig(0.2)
    rig.break_at = 0.5
    runs = runs_of(plant, store, rig)
    save, is_full = type(store.runs).save, True

    def full(self: RunTable, run: Run) -> None:
        if is_full and run.state is RunState.FAILED:
            raise OSError(28, "No space left on device")
        save(self, run)

    monkeypatch.setattr("service.runs.service._STORE_AGAIN_S", 0.05)
    monkeypatch.setattr(RunTable, "save", full)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert ended.state is RunState.FAILED
    assert store.runs.get(run.id).state is RunState.RUNNING
    is_full = False
    async with asyncio.timeout(10.0):
        while store.runs.get(run.id).state is RunState.RUNNING:  # noqa: ASYNC110  - a store sets no event
            await asyncio.sleep(0.02)
    assert store.runs.get(run.id).error == ended.error
    with pytest.raises(PermissiveError, match="acknowledge"):
        await runs.start("FV-101", "triangle", {})
    await runs.shut_down()


async def test_after_a_crash_the_valve_is_sent_to_safe_even_where_the_disk_is_full(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = store.runs.insert(stored(RunState.RUNNING))
    journal = JournalWriter(store.journal_path(run.id), {"valve": "FV-101", "entry_pa": 777.0})
    journal.append(block(50))
    journal.close()

    def no_room(*_: Any) -> tuple[str, str]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "write_recording", no_room)
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    after = store.runs.get(run.id)
    assert rig.safe_calls == [("FV-101", 1, 777.0)]
    assert after.state is RunState.INTERRUPTED
    assert after.safe_confirmed is True
    assert "No space left" in after.error
    assert store.journal_path(run.id).exists()


async def test_a_journal_that_takes_long_does_not_hold_up_the_valve(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = store.runs.insert(stored(RunState.RUNNING))
    rig, order = FakeRig(), list[str]()
    safe = threading.Event()

    async def go_safe(*_: Any) -> bool:
        order.append("safe")
        safe.set()
        return True

    def slow(*arguments: Any) -> Run:
        safe.wait(120.0)
        order.append("marked")
        return mark_interrupted(*arguments)

    monkeypatch.setattr(rig, "go_safe", go_safe)
    monkeypatch.setattr("service.runs.recovery.mark_interrupted", slow)
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    assert order == ["safe", "marked"]
    assert store.runs.get(run.id).safe_confirmed is True


async def test_a_test_whose_end_cannot_be_stored_still_ends_for_those_who_wait(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    async def unreachable(*_: Any) -> bool:
        raise RuntimeError("no wire")

    def save(run: Run) -> None:
        if run.state is not RunState.RUNNING:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(store.runs, "save", save)
    monkeypatch.setattr(rig, "go_safe", unreachable)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert ended.state is RunState.FAILED
    assert "SAFE STATE NOT CONFIRMED" in ended.error
    assert "Input/output error" in ended.error
    assert runs.user_of("FV-101") is None
    await runs.shut_down()


async def test_what_is_cancelled_at_the_end_of_the_service_is_waited_for(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    left_safe = False

    rig = FakeRig()

    async def play(*_: Any) -> Any:
        nonlocal left_safe
        rig.moving.set()
        try:
            await asyncio.sleep(60.0)
        finally:
            await asyncio.sleep(0.05)
            left_safe = True

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    await runs.start("FV-101", "triangle", {})
    await rig.moving.wait()
    await runs.shut_down(timeout_s=0.05)
    assert left_safe


async def test_progress_stays_where_a_test_was_stopped_and_its_notes_are_kept(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    async def play(order: Order, watcher: Watcher, stop: asyncio.Event) -> PlayOutcome:
        watcher.on_progress(0.2, "playing")
        rig.moving.set()
        await stop.wait()
        watcher.on_progress(1.0, "ended")
        return PlayOutcome(None, Ended.STOPPED, safe_confirmed=True, notes=("nothing was taken",))

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await rig.moving.wait()
    await runs.stop(run.id)
    ended = await runs.wait(run.id, 10.0)
    assert ended.progress == pytest.approx(0.2 * MOTION_SHARE)
    assert ended.quality == {"samples": 0, "notes": ["nothing was taken"], "ended": "stopped", "writes": 0}
    await runs.shut_down()
