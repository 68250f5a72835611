from __future__ import annotations

import asyncio
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.addresses import MotionLimits
from drivers.motion.orders import Order
from service.config.settings import load_plant
from service.model.run import RunState
from service.model.sequences import SEQUENCES, build_waveform, choose_waveform, default_of
from service.routes.recording_formats import CSV, PARQUET, acceptable
from service.runs.admission import Admission
from service.runs.bus_owners import BusOwners
from service.runs.events import EventLog
from service.runs.execution import Execution
from service.runs.live import LiveRun
from service.runs.stem_looks import StemLooks
from service.runs.tasks import Tasks
from service.store.store import Store
from service.workers.polling import Polling
from tests.service.stored_runs import runs_of, stored
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import motion_on
from valve.errors import BusyError, NotFoundError, RequestError, WaveformError
from valve.nameplate import Actuator, Nameplate, Signal

PLATE = Nameplate("X", Actuator(0.1, 0.06), Signal((4.0, 20.0), (10_000.0, 90_000.0)))
LIMITS = MotionLimits((0.0, 80_000.0), 30_000.0, 300.0)


@pytest.mark.parametrize("name", list(SEQUENCES))
def test_every_sequence_stays_between_signal_and_limits_by_default(name: str) -> None:
    waveform = build_waveform(name, {}, PLATE, LIMITS)
    assert waveform.range_pa == pytest.approx((10_000.0, 80_000.0))
    assert waveform.time_s.size <= 1024
    assert build_waveform(name, {"low_pa": 2e4, "high_pa": 3e4}, PLATE, LIMITS).range_pa == pytest.approx((2e4, 3e4))


@pytest.mark.parametrize(("rate_pa_per_s", "longest_s"), [(1.0e6, 600.0), (30_000.0, 600.0), (1.0e6, 100.0)])
def test_the_diagnostic_sequence_has_rates_rests_and_loops_within_its_time(
    rate_pa_per_s: float, longest_s: float
) -> None:
    limits = MotionLimits((0.0, 80_000.0), rate_pa_per_s, longest_s)
    waveform = build_waveform("diagnostic", {}, PLATE, limits)
    assert waveform.duration_s <= min(150.0, longest_s)
    assert waveform.fastest_rate_pa_per_s <= rate_pa_per_s
    run_s, rise_pa = np.diff(waveform.time_s), np.diff(waveform.pressure_pa)
    rates = np.abs(rise_pa / run_s)
    assert rates.max() > 3.0 * rates[rates > 0.0].min()
    rests_s = run_s[rise_pa == 0.0]
    assert rests_s.max() > 10.0 * rests_s.min() > 0.0
    # loops turn back within the range, below and above its middle, and each is smaller than the last
    turns_pa = waveform.pressure_pa[1:-1][np.sign(rise_pa[1:]) * np.sign(rise_pa[:-1]) < 0.0]
    inner_pa = turns_pa[(turns_pa > 11_000.0) & (turns_pa < 79_000.0)]
    assert (np.diff(np.abs(inner_pa - 45_000.0)[:6:2]) < 0.0).all()
    assert (inner_pa[:6:2] > 45_000.0).all()
    assert (inner_pa[1:6:2] < 45_000.0).all()


def test_the_triangle_is_the_papers() -> None:
    waveform = build_waveform("triangle", {}, PLATE, LIMITS)
    assert waveform.duration_s == 60.0
    assert build_waveform("triangle", {"period_s": 10, "cycles": 1}, PLATE, LIMITS).duration_s == 10.0


@pytest.mark.parametrize("rate_pa_per_s", [15_000.0, 30_000.0, 1.0e6])
def test_the_usual_sequence_takes_a_minute_and_is_as_fast_as_the_limit_allows(rate_pa_per_s: float) -> None:
    choice = choose_waveform(None, {}, PLATE, MotionLimits((0.0, 80_000.0), rate_pa_per_s, 300.0))
    assert (choice.name, choice.reason) == ("multi_rate", "")
    assert 40.0 < choice.waveform.duration_s <= 60.0
    fastest = min(rate_pa_per_s, 70_000.0 / 1.0)
    assert 0.85 * fastest < choice.waveform.fastest_rate_pa_per_s <= fastest
    # the paper's rate is among them
    assert choice.waveform.time_s[1] == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (MotionLimits((0.0, 80_000.0), 8_000.0, 300.0), "hardly another rate"),
        (MotionLimits((0.0, 80_000.0), 20_000.0, 25.0), "allow more time"),
    ],
)
def test_a_valve_whose_limits_do_not_allow_the_usual_sequence_gets_the_triangle(
    limits: MotionLimits, reason: str
) -> None:
    choice = choose_waveform(None, {}, PLATE, limits)
    assert choice.name == "triangle"
    assert reason in choice.reason
    assert default_of(PLATE, limits) == ("triangle", choice.reason)


def test_overrides_of_the_triangle_choose_it() -> None:
    choice = choose_waveform(None, {"cycles": 2, "period_s": 20}, PLATE, LIMITS)
    assert (choice.name, choice.waveform.duration_s) == ("triangle", 40.0)
    assert choose_waveform(None, {"low_pa": 2.0e4}, PLATE, LIMITS).name == "multi_rate"
    with pytest.raises(RequestError, match="periods"):
        choose_waveform(None, {"cycles": 2, "hold_s": 20}, PLATE, LIMITS)


def test_a_named_sequence_is_never_exchanged() -> None:
    with pytest.raises(WaveformError, match="hardly another rate"):
        choose_waveform("multi_rate", {}, PLATE, MotionLimits((0.0, 80_000.0), 8_000.0, 300.0))


def test_a_slow_transducer_can_be_told() -> None:
    waveform = build_waveform("multi_rate", {"fastest_period_s": 8, "duration_s": 100}, PLATE, LIMITS)
    assert waveform.fastest_rate_pa_per_s == pytest.approx(70_000.0 / 4.0, rel=0.1)
    assert 80.0 < waveform.duration_s <= 100.0


@pytest.mark.parametrize(
    ("name", "overrides", "part"),
    [
        ("waltz", {}, "triangle"),
        ("triangle", {"cycle": 1}, "cycle"),
        ("triangle", {"cycles": 0}, "cycles"),
        ("triangle", {"cycles": 1.5}, "cycles"),
        ("triangle", {"period_s": float("nan")}, "period_s"),
        ("triangle", {"period_s": "20"}, "period_s"),
        ("multi_rate", {"periods_s": []}, "periods_s"),
        ("steps", {"levels_percent": [0, 101]}, "levels_percent"),
    ],
)
def test_wrong_overrides_are_refused_by_name(name: str, overrides: dict[str, Any], part: str) -> None:
    with pytest.raises(RequestError, match=part):
        build_waveform(name, overrides, PLATE, LIMITS)


def test_a_span_that_falls_is_refused() -> None:
    with pytest.raises(WaveformError):
        build_waveform("triangle", {"low_pa": 5e4, "high_pa": 2e4}, PLATE, LIMITS)


def test_a_bus_has_one_owner_until_it_is_given_back() -> None:
    owners = BusOwners()
    claim = owners.claim("run-1", "A", {"bus-1", "bus-2"})
    with pytest.raises(BusyError, match="run-1 uses this valve"):
        owners.claim("run-2", "A", {"bus-9"})
    with pytest.raises(BusyError, match="bus-2"):
        owners.claim("run-2", "B", {"bus-2"})
    other = owners.claim("run-3", "C", {"bus-3"})
    assert owners.holder("A") == "run-1"
    owners.release(claim)
    owners.release(claim)
    owners.claim("run-4", "B", {"bus-2"})
    owners.release(other)


async def test_a_log_is_followed_by_many_each_from_where_it_wants() -> None:
    log = EventLog()
    log.append("a", {})

    async def read(after: int) -> list[int]:
        return [event.id async for events in log.follow(after, idle_s=5.0) for event in events]

    readers = [asyncio.create_task(read(after)) for after in (0, 1, 99)]
    await asyncio.sleep(0)
    log.append("b", {})
    await asyncio.sleep(0)
    log.append("c", {})
    log.close()
    assert [await reader for reader in readers] == [[1, 2, 3], [2, 3], [1, 2, 3]]


async def test_samples_that_come_close_together_reach_a_watcher_together_and_a_change_of_state_at_once() -> None:
    log = EventLog()
    seen: list[list[str]] = []

    async def watch() -> None:
        async for events in log.follow(idle_s=5.0):
            seen.append([event.kind for event in events])  # noqa: PERF401  - each as it comes

    watching = asyncio.create_task(watch())
    await asyncio.sleep(0)
    log.append("samples", {})
    await asyncio.sleep(0)
    log.append("samples", {})
    async with asyncio.timeout(5.0):
        while not seen:  # noqa: ASYNC110  # it is looked at from outside
            await asyncio.sleep(0.001)
    log.append("samples", {})
    log.append("state", {})
    for _ in range(3):
        await asyncio.sleep(0)
    assert seen == [["samples", "samples"], ["samples", "state"]]
    log.close()
    await watching


async def test_a_quiet_log_says_that_it_lives() -> None:
    log = EventLog()
    async for events in log.follow(idle_s=0.01):
        assert events == ()
        break


async def test_who_begins_to_watch_late_gets_the_past_in_a_few_pieces() -> None:
    log = EventLog()
    for number in range(1000):
        log.append("a", {"number": number})
    log.close()
    pieces = [[event.data["number"] for event in events] async for events in log.follow()]
    assert [number for piece in pieces for number in piece] == list(range(1000))
    assert len(pieces) == 4


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ("*/*", CSV),
        ("text/csv", CSV),
        ("application/vnd.apache.parquet", PARQUET),
        ("text/csv;q=0.5, application/x-parquet", PARQUET),
        ("text/*, application/*;q=0.9", CSV),
        ("*/*;q=0.1, text/csv;q=0", PARQUET),
        ("text/csv;q=nonsense, */*;q=0.2", PARQUET),
    ],
)
def test_the_format_is_what_the_client_prefers(accept: str, expected: str) -> None:
    assert acceptable(accept) == expected


async def test_the_intent_is_on_disk_before_the_rig_is_asked(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = Store(plant.service.store)
    seen: list[RunState] = []

    class Looking(FakeRig):
        async def play(self, *said: Any) -> Any:
            seen.append(store.runs.newest(1)[0].state)
            return await super().play(*said)

    runs = runs_of(plant, store, Looking())
    run = await runs.start("FV-101", "triangle", {})
    assert store.runs.get(run.id).valve == "FV-101"
    ended = await runs.wait(run.id, 10.0)
    assert seen == [RunState.RUNNING]
    # Where the stem stands is looked at again and again after a test has ended.
    assert replace(ended, stands=None) == replace(store.runs.get(run.id), stands=None)
    assert ended.recording_sha256 == hashlib.sha256(store.recording_path(run.id).read_bytes()).hexdigest()
    await runs.shut_down()
    store.close()


async def test_a_test_that_is_stopped_before_it_moves_never_moves(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = Store(plant.service.store)
    live = LiveRun(store.runs.insert(stored(RunState.QUEUED)))
    live.request_stop("stopped on request")
    rig, valve = FakeRig(), plant.valves["FV-101"]
    motion = motion_on(plant, rig, folder=store.folder)
    admission = Admission(plant, store, motion)
    owners, looks = admission.owners, StemLooks(store, motion, admission, Tasks())
    waveform = build_waveform("triangle", {}, valve.nameplate, valve.wiring.limits)
    order = Order(live.run.id, "FV-101", waveform, "triangle", live.run.number)
    claim = owners.claim(live.run.id, "FV-101", valve.buses)
    execution = Execution(live, valve, order, claim, store=store, owners=owners, looks=looks)
    await execution.run(motion, FakeAnalyst(), polling=Polling())
    assert live.run.state is RunState.STOPPED
    assert rig.orders == []
    assert owners.holder("FV-101") is None
    store.close()


async def test_nothing_starts_while_the_service_shuts_down(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = Store(plant.service.store)
    runs = runs_of(plant, store, FakeRig())
    runs.begin_shutdown()
    with pytest.raises(BusyError, match="shutting down"):
        await runs.start("FV-101", "triangle", {})
    with pytest.raises(NotFoundError):
        await runs.start("FV-1", "triangle", {})
    assert store.runs.newest(5) == []
    store.close()
