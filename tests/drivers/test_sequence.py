from __future__ import annotations

import asyncio
import math
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from drivers import polled_play
from drivers.addresses import MotionLimits, Parity, Point, RtuAddress
from drivers.device import connect_valve
from drivers.maps.reference import CaptureState, WatchdogState
from drivers.outcome import Ended, SampleBlock
from drivers.polled_play import PolledPlay
from drivers.transport import Transport
from tests.drivers.conftest import TIMEOUT_S
from tests.support.played_device import LIMITS, SAFE_PA, WAVE, WIRING, Bench, until
from tests.support.reference_device import METRE_PER_PA, SPAN_PA, ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort
from tests.support.stopwatch import Stopwatch
from valve.errors import (
    BusyError,
    ConfigurationError,
    DeviceError,
    MeasurementError,
    WaveformError,
    WireError,
)
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, steps, triangle


async def test_a_polled_test_records_the_stem_and_ends_safe(device: ReferenceDevice, bus: Transport) -> None:
    bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
    outcome = await bench.play()
    recording = outcome.recording
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    assert recording is not None
    assert recording.samples >= 8  # 26 on a machine with nothing else to do
    assert recording.provenance.acquisition is Acquisition.POLLED
    assert recording.command_pa is not None
    assert np.allclose(recording.position_m, recording.command_pa * METRE_PER_PA, rtol=1e-6)
    behind_pa = np.abs(recording.command_pa - WAVE.at(recording.time_s))
    assert np.median(behind_pa) < 0.02 * 200_000.0  # a busy machine may be late now and then
    assert recording.sent_s is not None
    assert recording.received_s is not None
    assert np.allclose(recording.time_s, 0.5 * (recording.sent_s + recording.received_s))
    assert recording.write_sent_s is not None
    assert recording.written_s is not None
    wrote = np.isfinite(recording.written_s)
    # a row writes where its command is another than before, and looks only after the write was confirmed
    assert (wrote[1:] == (np.diff(recording.command_pa) != 0.0)).all()
    assert wrote.sum() >= 8
    assert (recording.write_sent_s[wrote] < recording.written_s[wrote]).all()
    assert (recording.written_s[wrote] <= recording.sent_s[wrote]).all()
    assert device.output_pa == SAFE_PA
    assert device.value("run_owner") == 0
    assert device.value("watchdog_state") == WatchdogState.OFF
    assert device.ignored == 0
    assert [phase for _, phase in bench.phases][-1] == "ended"


async def test_a_captured_test_brings_every_sample_at_its_own_time(device: ReferenceDevice, bus: Transport) -> None:
    bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
    outcome = await bench.play(mode="captured", period_s=0.001)
    recording = outcome.recording
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    assert recording is not None
    assert recording.samples == 501
    assert recording.is_evenly_sampled
    assert recording.gaps == 0
    assert recording.command_pa is not None
    assert np.abs(recording.command_pa - WAVE.at(recording.time_s)).max() <= 0.51 * SPAN_PA / 65534 + 0.5
    assert np.abs(recording.position_m - WAVE.at(recording.time_s) * METRE_PER_PA).max() <= 1.1e-6
    recorded = np.concatenate([block.time_s for block in bench.blocks if block.recorded])
    assert np.array_equal(recorded, recording.time_s)
    assert any(not block.recorded for block in bench.blocks)
    assert device.value("run_owner") == 0


async def test_a_period_that_the_device_cannot_keep_exactly_is_recorded_as_it_was_kept(bench: Bench) -> None:
    outcome = await bench.play(mode="captured", period_s=1.0 / 3000.0)
    assert outcome.recording is not None
    assert outcome.recording.time_s[1] == pytest.approx(333.0e-6, rel=1e-9)
    assert outcome.recording.provenance.requested_period_s == pytest.approx(333.0e-6, rel=1e-9)


async def test_a_device_without_function_23_is_read_by_two_transactions(bench: Bench) -> None:
    slave = bench.device.slave
    whole = slave.answer
    slave.answer = lambda unit, pdu: bytes((0x97, 1)) if pdu[0] == 23 else whole(unit, pdu)  # type: ignore[method-assign]  # a device that lacks it
    outcome = await bench.play(mode="captured", period_s=0.001)
    assert outcome.recording is not None
    assert (outcome.recording.samples, outcome.recording.gaps) == (501, 0)


async def test_a_sample_that_begins_late_says_by_how_much(bench: Bench) -> None:
    def slowly(block: SampleBlock) -> None:
        bench.blocks.append(block)
        time.sleep(0.035)  # the event loop is held up: the next slot has begun when it goes on

    outcome = await bench.play(on_samples=slowly)
    assert outcome.recording is not None
    late_s = np.concatenate([block.late_s for block in bench.blocks if block.late_s is not None])
    assert late_s.size == outcome.recording.samples
    assert late_s.min() >= 0.0
    first_of_blocks = np.cumsum([block.time_s.size for block in bench.blocks])[:-1]
    assert late_s[first_of_blocks].min() > 0.01
    assert outcome.recording.sent_s is not None
    assert outcome.recording.write_sent_s is not None
    begun_s = np.fmin(outcome.recording.sent_s, outcome.recording.write_sent_s)
    slots = (begun_s - late_s) / 0.02
    assert np.median(np.abs(slots - np.round(slots))) < 0.1


async def test_the_valve_is_ramped_to_the_start_and_to_safe_at_the_allowed_rate(bench: Bench) -> None:
    limits = replace(LIMITS, pressure_rate_pa_per_s=200_000.0)
    bench.device.output_pa = 80_000.0
    await bench.play(limits=limits)
    times_s, pressures_pa = np.array(bench.device.moves).T
    rise_pa, run_s = np.abs(np.diff(pressures_pa)), np.diff(times_s)
    assert (rise_pa <= 200_000.0 * (run_s + 0.03) + 1.0).all()
    assert abs(pressures_pa[0] - 80_000.0) < 2_000.0


async def test_nothing_is_written_after_the_release(bench: Bench) -> None:
    await bench.play()
    writes = bench.device.slave.writes
    assert writes[-1][1:] == (36, [0, 7, 2])
    assert writes[-2][1] == 32


@pytest.mark.parametrize(
    ("waveform", "limits", "match"),
    [
        (triangle(0.5, 1, 0.0, 2.0 * SPAN_PA), LIMITS, "limits.pressure_pa"),
        (triangle(0.1, 1, 0.0, SPAN_PA), LIMITS, "limits.pressure_rate"),
        (steps([0.0, 1000.0], 0.2), LIMITS, "allow steps"),
        (triangle(20.0, 2, 0.0, SPAN_PA), LIMITS, "longest_test_s"),
    ],
)
async def test_a_waveform_beyond_the_limits_moves_nothing(
    bench: Bench, waveform: Waveform, limits: MotionLimits, match: str
) -> None:
    with pytest.raises(WaveformError, match=match):
        await bench.play(waveform, limits=limits)
    assert bench.device.slave.requests == []


async def test_steps_are_played_where_they_are_allowed(bench: Bench) -> None:
    outcome = await bench.play(steps([10_000.0, 50_000.0, 20_000.0], 0.1), limits=replace(LIMITS, steps_allowed=True))
    assert outcome.ended is Ended.COMPLETED
    assert {50_000.0, 20_000.0} <= set(bench.moved_pa)


async def test_a_plateau_is_commanded_once(bench: Bench) -> None:
    await bench.play(steps([10_000.0, 50_000.0], 0.3), limits=replace(LIMITS, steps_allowed=True))
    assert bench.moved_pa.count(50_000.0) == 1


async def test_another_device_is_never_moved(bench: Bench) -> None:
    bench.device.show(canary=4711)
    with pytest.raises(DeviceError, match="another device"):
        await bench.play()
    assert bench.device.slave.writes == []


async def test_another_version_of_the_map_is_never_moved(bench: Bench) -> None:
    bench.device.show(map_version=2)
    with pytest.raises(DeviceError, match="map_version"):
        await bench.play()
    assert bench.device.slave.writes == []


async def test_a_device_that_another_run_owns_is_left_alone(bench: Bench) -> None:
    bench.device.show(run_owner=6)
    with pytest.raises(BusyError, match="run 6"):
        await bench.play()
    assert bench.device.slave.writes == []


async def test_a_watchdog_that_does_not_arm_moves_nothing_and_releases(bench: Bench) -> None:
    device = bench.device
    obey = device.on_write

    def deaf(unit: int, address: int, words: list[int]) -> int | None:
        code = obey(unit, address, words)
        device.show(watchdog_state=WatchdogState.OFF)
        return code

    device.slave.on_write = deaf
    with pytest.raises(DeviceError, match="not armed"):
        await bench.play()
    assert device.moves == []
    assert device.value("run_owner") == 0


async def test_the_caller_hears_of_the_entry_before_anything_is_written(bench: Bench) -> None:
    bench.device.output_pa = 30_000.0
    heard = []

    async def ready(entry_pa: float, name: str) -> None:
        heard.append((entry_pa, name, len(bench.device.slave.writes)))

    await bench.play(on_ready=ready)
    assert heard == [(30_000.0, "reference (device 1 on plc)", 0)]


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_the_intent_comes_before_the_first_write_that_can_move_the_valve(bench: Bench, mode: str) -> None:
    seen = []

    async def intend() -> None:
        seen.append((bench.valve.commanded, bench.device.value("run_owner"), list(bench.moved_pa)))

    outcome = await bench.play(mode=mode, on_intent=intend)
    assert seen == [(False, 7, [])]
    assert outcome.commanded


@pytest.mark.parametrize("error", [OSError("no space left"), MeasurementError("the journal cannot be written")])
async def test_an_intent_that_cannot_be_written_moves_nothing_and_gives_the_device_back(
    bench: Bench, error: Exception
) -> None:
    async def intend() -> None:
        raise error

    with pytest.raises(type(error)):
        await bench.play(on_intent=intend)
    assert (bench.valve.commanded, bench.moved_pa, bench.device.value("run_owner")) == (False, [], 0)


async def test_an_error_of_any_type_after_the_first_write_leaves_it_known_that_the_valve_was_commanded(
    bench: Bench,
) -> None:
    def refuse(_: object) -> None:
        raise RuntimeError("whatever it is")

    with pytest.raises(RuntimeError, match="whatever"):
        await bench.play(on_samples=refuse)
    assert bench.valve.commanded


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_stop_goes_to_safe_at_once_and_keeps_what_was_recorded(
    device: ReferenceDevice, bus: Transport, mode: str
) -> None:
    bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
    long = triangle(20.0, 1, 10_000.0, 60_000.0)
    task = asyncio.create_task(bench.play(long, mode=mode, period_s=0.02 if mode == "polled" else 0.001))
    await until(lambda: any(phase == "playing" and share > 0.05 for share, phase in bench.phases))
    stopped_s, watch = time.monotonic(), Stopwatch()
    bench.stop.set()
    outcome = await task
    waited_s = time.monotonic() - stopped_s - watch.own_s  # for a core: none of ours
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.STOPPED, True)
    assert device.output_pa == SAFE_PA
    assert device.moves[-1][1] == SAFE_PA
    assert device.moves[-1][0] - stopped_s - waited_s < 0.2
    assert outcome.recording is not None
    assert outcome.recording.samples > 1  # on a busy machine a poll of the serial line is late
    assert device.value("capture_state") != CaptureState.RUNNING
    assert device.value("run_owner") == 0


@pytest.mark.parametrize("phase", ["ramping", "returning"])
async def test_a_stop_is_heard_while_an_output_that_lags_is_waited_for(bench: Bench, phase: str) -> None:
    device, at_once, waits = bench.device, bench.device.move, list[asyncio.TimerHandle]()
    start_pa = WAVE.pressure_pa[0] if phase == "ramping" else SAFE_PA
    bench.device.output_pa = 30_000.0
    phases: list[str] = []
    bench.on_phase = phases.append
    held_s: list[float] = []

    def lagging(pressure_pa: float) -> None:
        loop = asyncio.get_running_loop()
        if phases[-1] == phase and pressure_pa == start_pa and not held_s:
            held_s.append(time.monotonic())
            device.moves.append((time.monotonic(), pressure_pa))
            waits.append(loop.call_later(0.5, at_once, pressure_pa))
            loop.call_later(0.05, bench.stop.set)
        else:
            at_once(pressure_pa)

    device.move = lagging  # type: ignore[method-assign]
    outcome = await bench.play()
    for waiting in waits:
        waiting.cancel()
    assert held_s
    assert outcome.ended is Ended.STOPPED
    after_s = [at_s - held_s[0] for at_s, pressure_pa in device.moves if pressure_pa == SAFE_PA and at_s > held_s[0]]
    assert after_s[0] < 0.3, "the safe value is written once the stop is heard, not when the output has followed"


async def test_a_stop_before_the_first_move_ends_safe_without_playing(bench: Bench) -> None:
    bench.stop.set()
    bench.device.output_pa = 40_000.0
    outcome = await bench.play()
    assert (outcome.ended, outcome.safe_confirmed, outcome.recording) == (Ended.STOPPED, True, None)
    assert bench.device.output_pa == SAFE_PA
    assert max(bench.moved_pa) <= 40_000.0


async def test_a_cancelled_test_leaves_the_valve_safe(bench: Bench) -> None:
    task = asyncio.create_task(bench.play(triangle(20.0, 1, 10_000.0, 60_000.0)))
    await until(lambda: len(bench.device.moves) >= 5)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert bench.device.output_pa == SAFE_PA
    assert bench.device.value("run_owner") == 0


async def test_an_answer_that_is_lost_is_a_gap_and_the_test_goes_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(polled_play, "_GLANCE_PERIOD_S", math.inf)  # it is a sample's answer that is to be lost
    slave = bench.device.slave

    def lose_one(phase: str) -> None:
        if phase == "playing" and len(slave.faults) == 0 and not lost:
            lost.append(1)
            slave.faults.append(Fault(drop=True))

    lost: list[int] = []
    bench.on_phase = lose_one
    outcome = await bench.play(triangle(1.0, 1, 10_000.0, 60_000.0))
    assert outcome.ended is Ended.COMPLETED
    recording = outcome.recording
    assert recording is not None
    assert recording.command_pa is not None
    assert np.isnan(recording.position_m).sum() == 1
    good = np.isfinite(recording.position_m)
    assert np.allclose(recording.position_m[good], recording.command_pa[good] * METRE_PER_PA, rtol=1e-6)
    assert recording.sampling_quality().missed_slots >= 1


async def test_a_write_whose_answer_was_lost_is_not_written_again_when_the_device_shows_it(bench: Bench) -> None:
    slave = bench.device.slave
    obey = bench.device.on_write

    def lose(unit: int, address: int, words: list[int]) -> int | None:
        code = obey(unit, address, words)
        if address == 32 and bench.moved_pa[-1:] == [50_000.0] and bench.moved_pa.count(50_000.0) == 1:
            slave.always = Fault(drop=True)
            asyncio.get_running_loop().call_later(1.5 * TIMEOUT_S, setattr, slave, "always", Fault())
        return code

    slave.on_write = lose
    outcome = await bench.play(steps([10_000.0, 50_000.0], 0.6), limits=replace(LIMITS, steps_allowed=True))
    assert outcome.ended is Ended.COMPLETED
    assert bench.moved_pa.count(50_000.0) == 1


async def test_a_live_block_with_a_wrong_check_is_a_gap(bench: Bench) -> None:
    bench.on_phase = lambda phase: setattr(bench.device, "break_check", 1) if phase == "playing" else None
    outcome = await bench.play()
    assert outcome.ended is Ended.COMPLETED
    assert outcome.recording is not None
    assert np.isnan(outcome.recording.position_m).any()


async def test_a_window_with_a_wrong_check_is_read_again(bench: Bench) -> None:
    bench.device.break_windows = 2
    outcome = await bench.play(mode="captured", period_s=0.001)
    assert outcome.recording is not None
    assert outcome.recording.gaps == 0
    assert np.abs(outcome.recording.position_m - WAVE.at(outcome.recording.time_s) * METRE_PER_PA).max() <= 1.1e-6


async def test_a_window_that_stays_wrong_fails_the_test_and_the_valve_is_safe(bench: Bench) -> None:
    bench.device.break_windows = 1000
    outcome = await bench.play(mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, True)
    assert isinstance(outcome.error, WireError)


async def test_a_device_that_falls_silent_fails_the_test_and_is_not_called_safe(bench: Bench) -> None:
    bench.on_phase = lambda phase: (
        setattr(bench.device.slave, "always", Fault(drop=True, silent_execution=False)) if phase == "playing" else None
    )
    watch = Stopwatch()
    outcome = await bench.play(triangle(20.0, 1, 10_000.0, 60_000.0))
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, False)
    assert isinstance(outcome.error, WireError)
    assert "communication is lost" in str(outcome.error)
    assert watch.own_s < 10.0
    assert any("watchdog stays armed" in note for note in outcome.notes)
    bench.device.tick()
    assert bench.device.output_pa == SAFE_PA  # the device's own watchdog


async def test_an_output_that_does_not_follow_ends_the_test(bench: Bench) -> None:
    bench.on_phase = lambda phase: setattr(bench.device, "stuck", True) if phase == "playing" else None
    outcome = await bench.play(triangle(4.0, 1, 10_000.0, 60_000.0))
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, False)
    assert "the device shows" in str(outcome.error)


async def test_what_another_master_writes_between_two_samples_is_seen_and_ends_the_test(bench: Bench) -> None:
    foreign: list[asyncio.Task[None]] = []

    async def write_over_it() -> None:
        while True:  # now and then, for a moment: the next command of ours covers it up before the next sample
            await asyncio.sleep(0.004)
            bench.device.output_pa = 90_000.0

    def begin(phase: str) -> None:
        if phase == "playing" and not foreign:
            foreign.append(asyncio.get_running_loop().create_task(write_over_it()))

    bench.on_phase = begin
    outcome = await bench.play(triangle(10.0, 1, 10_000.0, 60_000.0), period_s=0.05)
    foreign[0].cancel()
    assert outcome.ended is Ended.FAILED
    assert "another master" in str(outcome.error)


async def test_an_output_that_lags_is_nobody_elses(bench: Bench) -> None:
    device, at_once = bench.device, bench.device.move
    scanned: list[asyncio.TimerHandle] = []

    def later(pressure_pa: float) -> None:
        device.moves.append((time.monotonic(), pressure_pa))
        if pressure_pa == SAFE_PA:
            for waiting in scanned:
                waiting.cancel()  # a card that still follows an older value would leave the safe one again
            at_once(pressure_pa)
            return
        scanned.append(asyncio.get_running_loop().call_later(0.15, lambda: setattr(device, "output_pa", pressure_pa)))

    device.move = later  # type: ignore[method-assign]  # a PLC's scan and its output card take their time
    outcome = await bench.play(triangle(2.0, 1, 10_000.0, 60_000.0))
    assert len(scanned) > 20
    assert (outcome.ended, outcome.error) == (Ended.COMPLETED, None)


async def test_a_watchdog_that_trips_ends_the_test(bench: Bench) -> None:
    bench.on_phase = lambda phase: (
        bench.device.show(watchdog_state=WatchdogState.TRIPPED, run_owner=0) if phase == "playing" else None
    )
    outcome = await bench.play(triangle(4.0, 1, 10_000.0, 60_000.0))
    assert outcome.ended is Ended.FAILED
    assert "watchdog tripped" in str(outcome.error)


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_stem_beyond_its_limits_ends_the_test(bench: Bench, mode: str) -> None:
    limits = replace(LIMITS, position_m=(0.0, 0.05))
    outcome = await bench.play(triangle(2.0, 1, 10_000.0, 60_000.0), mode=mode, limits=limits)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, True)
    assert "position" in str(outcome.error)


async def test_a_position_that_is_no_number_is_a_gap_and_ends_the_test_when_it_lasts(bench: Bench) -> None:
    bench.on_phase = lambda phase: (
        setattr(bench.device, "position_m", lambda _: math.nan) if phase == "playing" else None
    )
    outcome = await bench.play(triangle(8.0, 1, 10_000.0, 60_000.0))
    assert outcome.ended is Ended.FAILED
    assert "no valid position" in str(outcome.error)
    assert outcome.recording is not None
    assert np.isfinite(outcome.recording.position_m).mean() < 0.5


async def test_a_frozen_device_gives_gaps_and_no_samples(bench: Bench) -> None:
    bench.on_phase = lambda phase: setattr(bench.device, "frozen", True) if phase == "playing" else None
    wave = steps([10_000.0, 10_001.0], 2.0)
    outcome = await bench.play(wave, limits=replace(LIMITS, steps_allowed=True))
    assert outcome.ended is Ended.FAILED
    assert outcome.recording is not None
    assert np.isfinite(outcome.recording.position_m).sum() <= 7


async def test_the_watchdog_is_fed_while_the_device_plays_by_itself(bench: Bench) -> None:
    outcome = await bench.play(triangle(1.5, 1, 10_000.0, 60_000.0), mode="captured", period_s=0.001)
    assert (outcome.ended, outcome.error) == (Ended.COMPLETED, None)


async def test_the_value_at_entry_can_be_the_safe_one(device: ReferenceDevice, tcp: Transport) -> None:
    bench = Bench(device, connect_valve(replace(WIRING, safe_value_pa="entry"), {"bus": tcp}))
    device.output_pa = 33_000.0
    outcome = await bench.play()
    assert outcome.safe_confirmed
    assert device.output_pa == 33_000.0


async def test_a_slow_device_is_polled_on_the_grid_and_its_missed_slots_are_counted(bench: Bench) -> None:
    bench.on_phase = lambda phase: (
        setattr(bench.device.slave, "always", Fault(delay_s=0.02)) if phase == "playing" else None
    )
    outcome = await bench.play(triangle(1.0, 1, 10_000.0, 60_000.0))
    assert outcome.recording is not None
    quality = outcome.recording.sampling_quality()
    assert quality.missed_slots >= 20
    assert 15.0 < quality.achieved_rate_hz < 30.0
    assert outcome.recording.provenance.timing_uncertainty_s is not None
    assert outcome.recording.provenance.timing_uncertainty_s >= 0.009


async def test_50_hz_on_a_line_of_9600_baud_give_what_the_line_carries_and_say_so(
    device: ReferenceDevice, slave: RawSlave
) -> None:
    async with SerialPort(slave, paced=9600) as line:
        bus = Transport(RtuAddress("line", line.path, 9600, Parity.NONE))
        await bus.open()
        bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
        outcome = await bench.play(triangle(3.0, 1, 10_000.0, 60_000.0), period_s=0.02)
        await bus.close()
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    assert outcome.recording is not None
    assert outcome.recording.gaps == 0
    quality = outcome.recording.sampling_quality()
    # 25 bytes of a command, 39 of a look, 11 bits each: 73 ms
    assert 5.0 < quality.achieved_rate_hz < 14.0
    assert quality.missed_slots >= 100
    assert outcome.recording.provenance.timing_uncertainty_s is not None
    assert outcome.recording.provenance.timing_uncertainty_s >= 0.5 * 39 * 11 / 9600


async def test_a_map_that_cannot_capture_says_so(slave: RawSlave, tcp: Transport) -> None:
    wiring = replace(
        WIRING,
        command=Point("bus", 1, "advantech_adam_6024", signal=(0.004, 0.020), quantity=(0.0, SPAN_PA)),
        position=Point("bus", 1, "advantech_adam_6024", signal=(0.004, 0.020), quantity=(0.0, 0.1)),
    )
    bench = Bench(ReferenceDevice(slave), connect_valve(wiring, {"bus": tcp}))
    with pytest.raises(ConfigurationError, match="cannot capture"):
        await bench.play(mode="captured")


async def test_a_recording_is_put_together_beside_the_event_loop_on_which_other_valves_are_polled(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, on_loop = PolledPlay.recording, []

    def recording(self: PolledPlay, provenance: Provenance) -> Recording | None:
        on_loop.append(threading.current_thread() is threading.main_thread())
        return made(self, provenance)

    monkeypatch.setattr(PolledPlay, "recording", recording)
    outcome = await bench.play()
    assert outcome.recording is not None
    assert on_loop == [False]


async def test_samples_arrive_while_the_test_runs(bench: Bench) -> None:
    await bench.play(triangle(1.0, 1, 10_000.0, 60_000.0))
    assert len(bench.blocks) >= 5
    assert all(block.recorded and block.sent_s is not None for block in bench.blocks)
