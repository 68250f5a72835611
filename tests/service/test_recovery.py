"""What the next start does with the valves that a dead process left: promise 9 of docs/safety.md."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from drivers.motion.journal import JournalWriter
from drivers.outcome import Recovered, SafeOutcome
from drivers.stands_at import StemVerdict
from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.acknowledgement import alarm_of, last_end
from service.model.run import Run, RunState
from service.runs.recovery import mark_interrupted
from service.store.store import Store
from simulator.faults import Fault, FaultKind
from simulator.record import Happening
from tests.service.stored_runs import block, runs_of, stored
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, standing_valve, wired_plant
from valve.errors import PermissiveError

AUTOMATIC = "loop_in_manual: not in manual, the loop in manual is needed: put the loop in manual"


@pytest.fixture
def store(plant: Plant) -> Iterator[Store]:
    store = Store(plant.service.store)
    yield store
    store.close()


def commanded(store: Store, **changes: Any) -> Run:
    """Return a running test of a dead process whose journal shows that it commanded its valve."""
    run = store.runs.insert(replace(stored(RunState.RUNNING), started_at=datetime.now(UTC), **changes))
    journal = JournalWriter(store.journal_path(run.id), {"valve": run.valve, "entry_pa": 777.0})
    journal.note_commanded()
    journal.append(block(50))
    journal.close()
    return run


async def restarted(plant: Plant, store: Store, rig: FakeRig) -> None:
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.settled()
    await runs.shut_down()


async def test_a_test_that_was_only_queued_has_its_valve_read_and_no_alarm(plant: Plant, store: Store) -> None:
    run, rig = store.runs.insert(stored(RunState.QUEUED)), FakeRig()
    rig.recovered = Recovered(SafeOutcome(False, 55_000.0, "the test commanded nothing"))
    rig.stem_m = 0.0427
    await restarted(plant, store, rig)
    after = store.runs.get(run.id)
    assert rig.recoveries == [("FV-101", 1, None, False)]
    assert (after.state, after.commanded, after.safe_confirmed) == (RunState.INTERRUPTED, False, None)
    assert after.stands is not None
    assert (after.stands.verdict, after.stands.stem_m) == (StemVerdict.NOT_JUDGED, 0.0427)
    assert alarm_of(after) == ""
    assert last_end(after).met
    assert "nothing was moved" in after.error


async def test_a_commanded_valve_that_may_not_be_moved_now_is_told_as_it_stands_and_is_an_alarm(
    plant: Plant, store: Store
) -> None:
    run, rig = commanded(store), FakeRig()
    rig.recovered = Recovered(SafeOutcome(False, 55_000.0, f"it was not sent there, as {AUTOMATIC}"))
    rig.stem_m = 0.0427
    await restarted(plant, store, rig)
    after = store.runs.get(run.id)
    assert rig.recoveries == [("FV-101", 1, 777.0, True)]
    assert (after.commanded, after.safe_confirmed) == (True, False)
    assert after.stands is not None
    assert after.stands.stem_m == 0.0427
    assert "nothing was written" in after.error
    for words in ("SAFE STATE NOT CONFIRMED", "Stem 42.7 mm: 42 % open", "put the loop in manual"):
        assert words in alarm_of(after)
    runs = runs_of(plant, store, rig)
    with pytest.raises(PermissiveError, match="acknowledge"):
        await runs.start("FV-101", "triangle", {})
    await runs.shut_down()


@pytest.mark.parametrize("sent", [True, False])
async def test_a_commanded_valve_is_sent_to_safe_or_was_found_there_and_its_stem_is_looked_at(
    plant: Plant, store: Store, sent: bool
) -> None:
    run, rig = commanded(store), FakeRig()
    rig.recovered = Recovered(SafeOutcome(True), sent=sent)
    await restarted(plant, store, rig)
    after = store.runs.get(run.id)
    assert after.safe_confirmed is True
    assert ("was sent to its safe value" in after.error) == sent
    assert ("nothing was written" in after.error) != sent
    assert len(rig.looks) == 1
    assert after.recording_file is not None
    assert not store.journal_path(run.id).exists()
    assert rig.orders == [], "nothing resumes by itself"


def _flip(journal: Path, places: tuple[int, ...]) -> None:
    """Flip a bit in the first byte of some of a journal's lines, as a bad block does."""
    lines = journal.read_bytes().splitlines(keepends=True)
    for place in places:
        lines[place] = bytes([lines[place][0] ^ 0x01]) + lines[place][1:]
    journal.write_bytes(b"".join(lines))


async def test_a_journal_that_does_not_say_whether_its_valve_was_commanded_is_an_alarm(
    plant: Plant, store: Store
) -> None:
    run, rig = commanded(store), FakeRig()
    _flip(store.journal_path(run.id), (0, 1))
    rig.recovered = Recovered(SafeOutcome(False, 55_000.0, "its journal is damaged"))
    await restarted(plant, store, rig)
    after = store.runs.get(run.id)
    assert rig.recoveries == [("FV-101", 1, None, None)]
    assert (after.commanded, after.safe_confirmed) == (None, False)
    for words in ("SAFE STATE NOT CONFIRMED", "its journal is damaged"):
        assert words in alarm_of(after)
    assert store.journal_path(run.id).exists(), "what was shown is kept"
    assert not last_end(after).met


async def test_a_motion_that_ended_well_is_not_recovered_and_its_stem_is_looked_at(plant: Plant, store: Store) -> None:
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    await runs.shut_down()
    assert ended.stands is not None
    moving = replace(ended.stands, verdict=StemVerdict.MOVING)
    left = replace(ended, state=RunState.ANALYZING, motion_ended_at=datetime.now(UTC) - timedelta(days=3))
    store.runs.save(replace(left, stands=moving))
    rig = FakeRig()
    await restarted(plant, store, rig)
    after = store.runs.get(run.id)
    assert rig.recoveries == []
    assert [tag for tag, _ in rig.looks] == ["FV-101"]
    assert after.stands is not None
    assert after.stands.verdict is not StemVerdict.MOVING
    assert after.stands.after_s == pytest.approx(3 * 86400.0, abs=60.0)


async def test_a_valve_that_plant_toml_no_longer_names_is_said_so(plant: Plant, store: Store) -> None:
    gone = commanded(store, valve="FV-999")
    waited = store.runs.insert(replace(stored(RunState.QUEUED), valve="FV-998"))
    await restarted(plant, store, FakeRig())
    after = store.runs.get(gone.id)
    assert after.safe_confirmed is False
    assert "SAFE STATE NOT CONFIRMED: go and look at the valve: plant.toml no longer names it" in after.error
    assert store.runs.get(waited.id).safe_confirmed is None
    assert alarm_of(store.runs.get(waited.id)) == ""


async def test_after_a_crash_the_valve_is_sent_to_safe_even_where_the_disk_is_full(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = commanded(store)

    def no_room(*_: Any) -> tuple[str, str]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "write_recording", no_room)
    rig = FakeRig()
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    after = store.runs.get(run.id)
    assert rig.recoveries == [("FV-101", 1, 777.0, True)]
    assert after.state is RunState.INTERRUPTED
    assert after.safe_confirmed is True
    assert "No space left" in after.error
    assert store.journal_path(run.id).exists()


async def test_a_journal_that_takes_long_does_not_hold_up_the_valve(
    plant: Plant, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = commanded(store)
    rig, order = FakeRig(), list[str]()
    safe = threading.Event()

    async def recover(*_: Any, **__: Any) -> Recovered:
        order.append("safe")
        safe.set()
        return Recovered(SafeOutcome(True), sent=True)

    def slow(*arguments: Any) -> Run:
        safe.wait(120.0)
        order.append("marked")
        return mark_interrupted(*arguments)

    monkeypatch.setattr(rig, "recover", recover)
    monkeypatch.setattr("service.runs.recovery.mark_interrupted", slow)
    runs = runs_of(plant, store, rig)
    await runs.recover()
    await runs.shut_down()
    assert order == ["safe", "marked"]
    assert store.runs.get(run.id).safe_confirmed is True


@pytest.mark.parametrize(
    ("flipped", "faults", "sent"),
    [
        ((), (), True),
        ((), (Fault(FaultKind.LOOP_IN_AUTOMATIC, 0.0),), False),
        (None, (), False),
        ((0,), (), True),
        ((0, 1), (), False),
    ],
    ids=[
        "commanded",
        "commanded, and the loop is in automatic again",
        "only queued",
        "commanded, its journal's header damaged",
        "its journal does not say it",
    ],
)
async def test_on_real_wires_only_what_was_commanded_and_may_move_now_is_written_to(
    quick_path: Path, flipped: tuple[int, ...] | None, faults: tuple[Fault, ...], sent: bool
) -> None:
    left_pa, is_commanded = 55_000.0, flipped is not None
    async with wired_plant(quick_path, valve=standing_valve(left_pa, *faults)) as (path, plant):
        settings = load_plant(path)
        store = Store(settings.service.store)
        run = store.runs.insert(stored(RunState.QUEUED)) if flipped is None else commanded(store)
        if flipped:
            _flip(store.journal_path(run.id), flipped)
        store.close()
        async with running_service(settings, None, FakeAnalyst()) as client:
            async with asyncio.timeout(30.0):
                while True:
                    after = (await client.get(f"/tests/{run.id}")).json()
                    if after["stands"] is not None and after["stands"]["verdict"] != "moving":
                        break
                    await asyncio.sleep(0.05)
            alarms = (await client.get(f"/valves/{TAG}")).json()["alarms"]
        moved = [one for one in plant.records[TAG].events if one.happening is Happening.COMMANDED]
        assert bool(moved) == sent
        assert asked_pa(plant) == pytest.approx(SAFE_PA if sent else left_pa, abs=10.0)
        assert after["state"] == "interrupted"
        assert after["safe_confirmed"] is (sent if is_commanded else None)
        assert after["stands"]["signal_pa"] == pytest.approx(SAFE_PA if sent else left_pa, abs=10.0)
        assert after["stands"]["stem_m"] is not None
        assert bool(alarms) == is_commanded
        if is_commanded and not sent:
            assert "SAFE STATE NOT CONFIRMED" in alarms[0]
            assert ("loop_in_manual: not in manual" if faults else "its journal is damaged") in alarms[0]
