"""What becomes of a test when the process, the disk, the wire or the service ends."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.addresses import ValveWiring
from drivers.motion.journal import JournalWriter
from drivers.motion.orders import Order
from drivers.motion.rig import Watcher
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from service.config.plant import Plant
from service.model.run import Run, RunState
from service.runs.left_journal import keep_journals_of_ended_runs
from service.runs.live import MOTION_SHARE
from service.runs.recovery import mark_interrupted
from service.runs.service import Runs
from service.shown.ending import ending_of
from service.store.run_table import RunTable
from service.store.store import Store
from tests.service.stored_runs import runs_of, stored
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import motion_on
from valve.errors import DeviceError, PermissiveError, RequestError


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    store = Store(plant.service.store)
    yield store
    store.close()


@pytest.mark.parametrize("safe", [True, False])
@pytest.mark.parametrize(
    "failure", [DeviceError("FV-101: look at it"), RequestError("FV-101: correct it"), RuntimeError("a fault of ours")]
)
async def test_whatever_error_comes_after_a_command_the_valve_is_sent_to_safe_and_it_is_an_alarm(
    plant: Plant, store: Store, failure: Exception, safe: bool
) -> None:
    rig = FakeRig()
    rig.break_at, rig.failure, rig.safe_confirmed = 0.5, failure, safe
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert rig.safe_calls == [("FV-101", 1, 1234.0)]
    assert (ended.state, ended.commanded, ended.safe_confirmed) == (RunState.FAILED, True, safe)
    assert str(failure) in ended.error
    assert "nothing was moved" not in ended.error
    assert ("SAFE STATE NOT CONFIRMED" in ended.error) == (not safe)
    assert replace(store.runs.get(run.id), stands=None) == replace(ended, stands=None)
    assert "moved" not in ending_of(ended).headline
    with pytest.raises(PermissiveError, match="acknowledge"):
        await runs.start("FV-101", "triangle", {})
    await runs.shut_down()


@pytest.mark.parametrize("failure", [DeviceError("FV-101: look at it"), RuntimeError("a fault of ours")])
async def test_whatever_error_comes_before_a_command_nothing_is_written_and_nothing_was_moved(
    plant: Plant, store: Store, failure: Exception
) -> None:
    rig = FakeRig()
    rig.refusal = failure
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert rig.safe_calls == []
    assert (ended.state, ended.commanded, ended.safe_confirmed) == (RunState.FAILED, False, None)
    assert "(nothing was moved)" in ended.error
    assert "before anything moved" in ending_of(ended).headline
    again = await runs.start("FV-101", "triangle", {})
    await runs.wait(again.id, 10.0)
    await runs.shut_down()


async def test_nothing_moves_where_its_intent_cannot_be_written(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: JournalWriter) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(JournalWriter, "note_commanded", full)
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert not rig.moving.is_set()
    assert (ended.commanded, ended.safe_confirmed) == (False, None)
    assert "No space left on device" in ended.error
    await runs.shut_down()


async def test_a_test_that_completed_was_commanded_and_one_that_was_stopped_while_it_waited_was_not(
    plant: Plant, store: Store
) -> None:
    runs = runs_of(plant, store, FakeRig())
    run = await runs.start("FV-101", "triangle", {})
    assert (await runs.wait(run.id, 10.0)).commanded is True
    run = await runs.start("FV-101", "triangle", {})
    await runs.stop(run.id)
    stopped = await runs.wait(run.id, 10.0)
    assert (stopped.state, stopped.commanded) == (RunState.STOPPED, False)
    await runs.shut_down()


@pytest.mark.parametrize("commanded", [True, False])
def test_an_interrupted_test_keeps_whether_it_commanded_its_valve(store: Store, commanded: bool) -> None:
    run = store.runs.insert(stored(RunState.RUNNING))
    journal = JournalWriter(store.journal_path(run.id), {"valve": "FV-101"})
    if commanded:
        journal.note_commanded()
    journal.close()
    mark_interrupted(store, run)
    assert store.runs.get(run.id).commanded is commanded


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


async def test_a_test_whose_end_cannot_be_stored_still_ends_for_those_who_wait(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    def save(run: Run) -> None:
        if run.state is not RunState.RUNNING:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(store.runs, "save", save)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert (ended.state, ended.commanded, ended.safe_confirmed) == (RunState.FAILED, True, True)
    assert rig.safe_calls == [], "it was read back at its safe value and let go: nothing more is written"
    assert "Input/output error" in ended.error
    async with asyncio.timeout(10.0):
        while runs.user_of("FV-101") is not None:  # noqa: ASYNC110  - its stem is looked at
            await asyncio.sleep(0.01)
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


@pytest.mark.parametrize("commanded", [True, False])
async def test_a_test_that_is_cancelled_as_the_service_ends_is_stored_with_how_its_valve_stands(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch, commanded: bool
) -> None:
    rig = FakeRig()

    async def play(_: ValveWiring, __: Order, watcher: Watcher, *___: Any) -> PlayOutcome:
        await watcher.on_ready(1234.0, "fake device")
        try:
            rig.moving.set()
            await asyncio.sleep(60.0)
        finally:
            if commanded:
                watcher.on_commanded()
        raise AssertionError

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await rig.moving.wait()
    await runs.shut_down(timeout_s=0.05)
    kept = store.runs.get(run.id)
    assert (kept.state, kept.commanded) == (RunState.FAILED, commanded)
    assert kept.safe_confirmed is (True if commanded else None)
    assert len(rig.safe_calls) == commanded
    assert "cancelled as the service ended" in kept.error


async def test_an_outcome_that_comes_in_spite_of_a_cancellation_is_stored_with_its_recording(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, letting_go = FakeRig(), asyncio.Event()
    played = rig.play

    async def play(*said: Any) -> PlayOutcome:
        outcome = await played(*said)
        letting_go.set()
        try:
            await asyncio.sleep(60.0)
        except asyncio.CancelledError:
            return outcome
        raise AssertionError

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await letting_go.wait()
    await runs.shut_down(timeout_s=0.05)
    kept = store.runs.get(run.id)
    assert kept.recording_sha256 is not None
    assert (kept.commanded, kept.safe_confirmed) == (True, True)
    assert not store.journal_path(run.id).exists()


async def test_a_test_that_is_cancelled_before_it_began_moves_nothing(plant: Plant, store: Store) -> None:
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await asyncio.sleep(0)  # its first step: it is being stored as running
    for task in list(runs._tasks._tasks):
        task.cancel()
    await runs.settled()
    assert rig.orders == []
    assert (store.runs.get(run.id).state, store.runs.get(run.id).commanded) == (RunState.STOPPED, False)
    await runs.shut_down()


async def test_a_disk_that_is_busy_holds_up_neither_the_valve_nor_the_event_loop(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    append, sync, journal_file = JournalWriter.append, JournalWriter.sync, store.folder / "journals"

    writers: set[int] = set()  # threads

    def slow_append(self: JournalWriter, block: SampleBlock) -> None:
        writers.add(threading.get_ident())
        time.sleep(0.08)
        append(self, block)

    def slow_sync(self: JournalWriter) -> None:
        writers.add(threading.get_ident())
        time.sleep(0.4)
        sync(self)

    monkeypatch.setattr(JournalWriter, "append", slow_append)
    monkeypatch.setattr(JournalWriter, "sync", slow_sync)
    shown: list[tuple[int, int]] = []  # samples shown so far, and lines in the journal then

    def on_samples(_: str, block: SampleBlock) -> None:
        lines = next(journal_file.glob("*.journal")).read_bytes().count(b"\n")
        shown.append(((shown[-1][0] if shown else 0) + block.time_s.size, lines - 2))

    rig = FakeRig(1.5)
    runs = Runs(
        plant,
        store,
        motion_on(plant, rig, folder=store.folder),
        FakeAnalyst(),
        software="breakaway 0",
        on_samples=on_samples,
    )
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 20.0)
    assert ended.state is RunState.COMPLETED
    assert threading.get_ident() not in writers, "the event loop waits for the disk"
    assert shown[-1][0] == 200
    assert all(samples <= lines for samples, lines in shown), "a sample was shown before it was written"
    await runs.shut_down()


async def test_a_disk_that_takes_no_sample_for_seconds_ends_the_test(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = threading.Event()
    monkeypatch.setattr("drivers.motion.kept_samples._LONGEST_S", 0.3)
    monkeypatch.setattr(JournalWriter, "append", lambda *_: free.wait(60.0))
    rig = FakeRig(20.0)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    free.set()
    assert ended.state is RunState.FAILED
    assert "samples can no longer be written" in ended.error
    assert ended.safe_confirmed is True
    await runs.shut_down()


async def test_a_safe_state_that_is_not_confirmed_says_why_in_the_test(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    async def play(*_: Any) -> PlayOutcome:
        return PlayOutcome(None, Ended.FAILED, safe_confirmed=False, why_unsafe="the device shows 7 Pa and not 0 Pa")

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert "SAFE STATE NOT CONFIRMED" in ended.error
    assert "the device shows 7 Pa and not 0 Pa" in ended.error
    await runs.shut_down()


@pytest.mark.parametrize("by", ["stop", "shutdown"])
async def test_a_stop_and_a_shutdown_are_heard_while_a_capture_is_uploaded(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    rig = FakeRig()

    async def play(_: ValveWiring, __: Order, watcher: Watcher, stop: asyncio.Event, ___: Any) -> PlayOutcome:
        watcher.on_commanded()
        watcher.on_progress(0.9, "uploading")
        rig.moving.set()
        await stop.wait()
        return PlayOutcome(None, Ended.STOPPED, safe_confirmed=True)

    monkeypatch.setattr(rig, "play", play)
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await rig.moving.wait()
    if by == "stop":
        assert (await runs.stop(run.id)).safe_confirmed is True, "the valve is at its safe value already"
    else:
        runs.begin_shutdown()
    ended = await runs.wait(run.id, 10.0)
    assert ended.state is RunState.STOPPED
    assert ("shut down" in ended.error) == (by == "shutdown")
    await runs.shut_down()


async def test_progress_stays_where_a_test_was_stopped_and_its_notes_are_kept(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    async def play(_: ValveWiring, order: Order, watcher: Watcher, stop: asyncio.Event, __: Any) -> PlayOutcome:
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
