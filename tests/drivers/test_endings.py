"""However a test ends, and wherever it is then: the valve is safe and released, and no sample is another's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.addresses import Parity, RtuAddress, WatchdogChoice
from drivers.device import connect_valve
from drivers.maps.reference import CaptureState, WatchdogState
from drivers.outcome import Ended, SampleBlock
from drivers.transport import Transport
from tests.drivers.conftest import TIMEOUT_S
from tests.support.played_device import LIMITS, SAFE_PA, WAVE, WIRING, Bench, until
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, SerialPort
from valve.errors import DeviceError, WireError
from valve.waveform import triangle

LONG = triangle(20.0, 1, 10_000.0, 60_000.0)
MANY_CORNERS = triangle(0.05, 40, 10_000.0, 11_000.0)


def after_writes(bench: Bench, address: int, act: Callable[[], object], nth: int = 1) -> None:
    """Call ``act`` right after the device carried out the nth write at an address."""
    obey, seen = bench.device.on_write, [0]

    def wrapped(unit: int, at: int, words: list[int]) -> int | None:
        code = obey(unit, at, words)
        seen[0] += at == address
        if at == address and seen[0] == nth:
            act()
        return code

    bench.device.slave.on_write = wrapped


def is_released_and_safe(device: ReferenceDevice) -> bool:
    free = device.value("run_owner") == 0 and device.value("watchdog_state") == WatchdogState.OFF
    return free and device.output_pa == SAFE_PA


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_fault_of_whoever_takes_the_samples_leaves_the_valve_safe(bench: Bench, mode: str) -> None:
    def full_disk(_: SampleBlock) -> None:
        raise OSError("no space left")

    with pytest.raises(OSError, match="no space left"):
        await bench.play(LONG, mode=mode, on_samples=full_disk)
    assert is_released_and_safe(bench.device)


async def test_a_caller_that_is_cancelled_twice_leaves_the_valve_safe_all_the_same(bench: Bench) -> None:
    task = asyncio.create_task(bench.play(LONG))
    await until(lambda: len(bench.device.moves) >= 5)
    bench.device.slave.always = Fault(delay_s=0.03)
    task.cancel()
    for _ in range(20):
        await asyncio.sleep(0.005)
        task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert is_released_and_safe(bench.device)


@pytest.mark.parametrize("address", [36, 44])
async def test_a_caller_that_is_cancelled_while_the_device_is_taken_leaves_it_to_others(
    bench: Bench, address: int
) -> None:
    task = asyncio.create_task(bench.play(LONG))
    after_writes(bench, address, task.cancel)
    with pytest.raises(asyncio.CancelledError):
        await task
    assert bench.device.value("run_owner") == 0
    assert bench.device.value("watchdog_state") == WatchdogState.OFF
    assert bench.device.moves == []


async def test_a_take_whose_answer_is_lost_does_not_keep_the_device(bench: Bench) -> None:
    obey = bench.device.on_write

    def lose_the_take(unit: int, at: int, words: list[int]) -> int | None:
        code = obey(unit, at, words)
        if at == 36 and words[2] == 1:
            bench.device.slave.always = Fault(drop=True)
            asyncio.get_running_loop().call_later(1.5 * TIMEOUT_S, setattr, bench.device.slave, "always", Fault())
        return code

    bench.device.slave.on_write = lose_the_take
    with pytest.raises(WireError):
        await bench.play(LONG)
    assert bench.device.value("run_owner") == 0
    assert bench.device.moves == []


async def test_a_valve_without_a_valid_position_is_not_moved(bench: Bench) -> None:
    bench.device.position_m = lambda _: float("nan")
    with pytest.raises(DeviceError, match="no valid position before"):
        await bench.play()
    assert bench.device.slave.writes == []


async def test_a_stop_before_the_capture_brings_no_samples_of_an_earlier_one(bench: Bench) -> None:
    await bench.play(mode="captured", period_s=0.001)
    bench.device.show(capture_run=6)
    bench.stop.set()
    bench.blocks.clear()
    outcome = await bench.play(mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.recording) == (Ended.STOPPED, None)
    assert bench.blocks == []


async def test_a_stop_while_the_waveform_is_handed_over_is_heard_before_its_end(bench: Bench) -> None:
    after_writes(bench, 1000, bench.stop.set)
    outcome = await bench.play(MANY_CORNERS, mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.safe_confirmed, outcome.recording) == (Ended.STOPPED, True, None)
    assert [at for _, at, _ in bench.device.slave.writes if 1000 <= at < 6000] == [1000]
    assert is_released_and_safe(bench.device)


async def test_a_stop_during_the_upload_ends_it_and_keeps_what_came(bench: Bench) -> None:
    bench.on_phase = lambda phase: bench.stop.set() if phase == "uploading" else None
    outcome = await bench.play(triangle(1.1, 1, 10_000.0, 60_000.0), mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.STOPPED, True)
    assert outcome.recording is not None
    assert outcome.recording.samples == 1000
    assert any("1000 of 1101 samples" in note for note in outcome.notes)


async def test_a_stop_during_the_upload_is_heard_after_the_transaction_under_way(bench: Bench) -> None:
    slave, asked = bench.device.slave, 0

    def stop(phase: str) -> None:
        nonlocal asked
        if phase == "uploading" and not bench.stop.is_set():
            asked = len(slave.requests)
            slave.always = Fault(delay_s=0.1)
            bench.device.break_windows = 1000  # each window would be read three times
            bench.stop.set()

    bench.on_phase = stop
    outcome = await bench.play(triangle(3.0, 1, 10_000.0, 60_000.0), mode="captured", period_s=0.001)
    reads = [request for request in slave.requests[asked:] if request[1] in (3, 4, 23)]
    assert len(reads) <= 6, "the one under way, then the release and what is read back of it"
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.STOPPED, True)
    assert is_released_and_safe(bench.device)


@pytest.mark.parametrize("mode", ["polled", "captured"])
@pytest.mark.parametrize("wait_s", [0.0, 0.01, 0.03, 0.06, 0.1, 0.2])
async def test_a_cancellation_after_the_motion_loses_neither_the_outcome_nor_the_recording(
    bench: Bench, mode: str, wait_s: float
) -> None:
    bench.device.slave.always = Fault(delay_s=0.01)
    task = asyncio.create_task(bench.play(WAVE, mode=mode))
    last = "uploading" if mode == "captured" else "returning"
    await until(lambda: any(phase == last for _, phase in bench.phases))
    await until(lambda: bench.device.output_pa == SAFE_PA)
    if mode == "polled":  # the way back ends when its value was seen
        await until(lambda: bench.valve.in_force_pa == SAFE_PA)
        await asyncio.sleep(0.1)
    await asyncio.sleep(wait_s)
    if task.done():
        return
    for _ in range(3):
        task.cancel()
        await asyncio.sleep(0.002)
    outcome = await task
    assert outcome.safe_confirmed
    assert outcome.recording is not None or mode == "captured"
    assert is_released_and_safe(bench.device)


async def test_a_release_that_fails_is_tried_again_then_said_and_logged(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    obey, tries = bench.device.on_write, [0]

    def keep(unit: int, at: int, words: list[int]) -> int | None:
        if at == 36 and words[2] == 2:
            tries[0] += 1
            return 6
        return obey(unit, at, words)

    bench.device.slave.on_write = keep
    outcome = await bench.play(WAVE)
    assert tries[0] == 3
    assert outcome.safe_confirmed
    assert any("was not released" in note and "busy" in note for note in outcome.notes)
    assert "was not released" in caplog.text


async def test_a_device_that_cannot_be_given_back_before_anything_moved_is_said(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    obey = bench.device.on_write

    def keep(unit: int, at: int, words: list[int]) -> int | None:
        return 6 if at == 44 or (at == 36 and words[2] == 2) else obey(unit, at, words)

    bench.device.slave.on_write = keep
    with pytest.raises(DeviceError, match="may stay with run 7"):
        await bench.play(WAVE)
    assert "was not released" in caplog.text
    assert not bench.valve.commanded


async def test_a_safe_write_that_fails_behind_an_error_of_ours_is_logged(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    def full_disk(_: SampleBlock) -> None:
        bench.device.slave.always = Fault(drop=True, silent_execution=False)
        raise OSError("no space left")

    with pytest.raises(OSError, match="no space left"):
        await bench.play(LONG, on_samples=full_disk)
    assert "safe state not confirmed" in caplog.text
    assert "no answer" in caplog.text


async def test_the_watchdog_is_fed_while_corners_are_written_and_samples_fetched_on_a_slow_line(
    device: ReferenceDevice, serial_port: SerialPort
) -> None:
    wiring = replace(WIRING, watchdog=WatchdogChoice(timeout_s=0.6))
    # Its own deadline: with the others' a busy machine makes gaps of these late answers.
    line = Transport(RtuAddress("line", serial_port.path, 115200, Parity.NONE))
    await line.open()
    bench = Bench(device, connect_valve(wiring, {"bus": line}))
    device.slave.always = Fault(delay_s=0.05)
    tripped = []
    tick = device.tick

    def watched() -> None:
        tick()
        if device.value("watchdog_state") == WatchdogState.TRIPPED:
            tripped.append(time.monotonic())

    device.tick = watched  # type: ignore[method-assign]  # a judge looks on
    outcome = await bench.play(MANY_CORNERS, mode="captured", period_s=0.001)
    await line.close()
    assert (outcome.ended, outcome.error, tripped) == (Ended.COMPLETED, None, [])
    assert outcome.recording is not None
    assert outcome.recording.samples == 2001


async def test_a_ramp_goes_on_from_where_it_was_after_a_disturbance(bench: Bench) -> None:
    bench.device.output_pa = 0.0
    limits = replace(LIMITS, pressure_rate_pa_per_s=50_000.0)
    slave = bench.device.slave

    def silent_for_a_while() -> None:
        slave.always = Fault(drop=True, silent_execution=False)
        asyncio.get_running_loop().call_later(0.3, setattr, slave, "always", Fault())

    after_writes(bench, 32, silent_for_a_while, nth=3)
    await bench.play(triangle(2.0, 1, 40_000.0, 60_000.0), limits=limits)
    up = [pressure_pa for pressure_pa in bench.moved_pa if pressure_pa <= 40_000.0][:8]
    assert np.diff(up).max() <= 0.2 * 50_000.0 + 1.0


async def test_a_scan_that_is_slower_than_the_look_does_not_hide_the_safe_value(bench: Bench) -> None:
    fresh = bench.device._sample
    last_s = [0.0]

    def seldom() -> None:
        if time.monotonic() - last_s[0] > 0.15:
            last_s[0] = time.monotonic()
            fresh()

    await bench.valve.take_ownership(7)
    bench.device._sample = seldom  # type: ignore[method-assign]  # a PLC whose scan takes 150 ms
    assert (await bench.valve.go_safe()).confirmed
    assert bench.moved_pa == [SAFE_PA]


async def test_an_answer_that_is_lost_while_the_safe_value_is_confirmed_costs_no_second_write(
    device: ReferenceDevice, rtu: Transport
) -> None:
    bench = Bench(device, connect_valve(WIRING, {"bus": rtu}))
    await bench.valve.identify()
    await bench.valve.take_ownership(7)
    after_writes(bench, 32, lambda: device.slave.faults.extend([Fault(), Fault(drop=True), Fault(drop=True)]))
    assert (await bench.valve.go_safe()).confirmed
    assert bench.moved_pa == [SAFE_PA]


async def test_a_late_write_that_moves_the_valve_before_the_fence_closes_is_told(bench: Bench) -> None:
    def wake_up() -> None:
        bench.device.output_pa = 44_000.0

    after_writes(bench, 36, wake_up, nth=2)
    outcome = await bench.play(WAVE)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.COMPLETED, False)
    assert any("late write" in note for note in outcome.notes)
    assert "the device shows 44000 Pa and not 5000 Pa" in outcome.why_unsafe


async def test_a_capture_that_is_stopped_before_its_start_never_starts(bench: Bench) -> None:
    bench.on_phase = lambda phase: bench.stop.set() if phase == "ramping" else None
    outcome = await bench.play(LONG, mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.recording) == (Ended.STOPPED, None)
    assert bench.device.value("capture_state") == CaptureState.IDLE
