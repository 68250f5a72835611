"""One test on one valve: from its present output to the waveform, along it, and to the safe value however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final

import numpy as np

from drivers.abort_rules import AbortRules
from drivers.addresses import Mode, MotionLimits
from drivers.capture_buffer import CaptureBuffer, Progress
from drivers.device import ValveDevice
from drivers.outcome import Ended, PlayOutcome, Sample, SampleBlock
from drivers.rows import CapturedRows, PolledRows
from valve.errors import ConfigurationError, DeviceError, EquipmentError, ValveError, WaveformError
from valve.recording import Provenance, Recording
from valve.waveform import Waveform

OnSamples = Callable[[SampleBlock], None]
OnProgress = Callable[[float, str], None]
OnReady = Callable[[float, str], Awaitable[None]]

_RAMP_PERIOD_S: Final = 0.05
_WATCH_PERIOD_S: Final = 0.1  # how often a captured test is looked at, and samples are handed on
_UPLOAD_BLOCK: Final = 25  # windows
_PLAY_FROM, _PLAY_TO, _POLLED_TO = 0.05, 0.8, 0.95  # shares of the progress


class _StopError(Exception):
    """Somebody asked for the end."""


def check_waveform(tag: str, waveform: Waveform, limits: MotionLimits) -> None:
    """Refuse what the valve must not do. Raises WaveformError."""
    (low_pa, high_pa), (least_pa, most_pa) = waveform.range_pa, limits.pressure_pa
    slack_pa = 1.0e-9 * (most_pa - least_pa)
    if low_pa < least_pa - slack_pa or high_pa > most_pa + slack_pa:
        raise WaveformError(
            f"{tag}: waveform {waveform.name} goes from {low_pa:g} to {high_pa:g} Pa, limits.pressure_pa allows "
            f"{least_pa:g} to {most_pa:g} Pa: choose a smaller range"
        )
    rate = waveform.fastest_rate_pa_per_s
    if rate > limits.pressure_rate_pa_per_s * (1.0 + 1.0e-9) and not limits.steps_allowed:
        raise WaveformError(
            f"{tag}: waveform {waveform.name} changes by {rate:g} Pa/s, limits.pressure_rate_pa_per_s allows "
            f"{limits.pressure_rate_pa_per_s:g} Pa/s: choose a longer period, or allow steps"
        )
    if waveform.duration_s > limits.longest_test_s:
        raise WaveformError(
            f"{tag}: waveform {waveform.name} lasts {waveform.duration_s:g} s, limits.longest_test_s allows "
            f"{limits.longest_test_s:g} s: choose fewer cycles or a shorter period"
        )


async def play_sequence(
    device: ValveDevice,
    waveform: Waveform,
    *,
    mode: Mode | str,
    period_s: float,
    run_number: int,
    stop: asyncio.Event,
    on_samples: OnSamples,
    on_progress: OnProgress,
    limits: MotionLimits,
    provenance: Provenance,
    on_ready: OnReady | None = None,
) -> PlayOutcome:
    """Play ``waveform`` on a valve and record it.

    Everything that can be refused is refused before anything moves, as a ValveError: the waveform against the limits,
    the device's identity, its owner, its watchdog. ``on_ready`` is awaited with the output at entry (Pa) and the
    device's name before the first write. From the first move on every end is an outcome: the valve is sent to its
    safe value, this is read back, and nothing but the release is written afterwards; where it is not confirmed the
    watchdog stays armed. A cancelled caller gets the same, then the cancellation.
    """
    check_waveform(device.tag, waveform, limits)
    play = _Play(
        device=device,
        waveform=waveform,
        period_s=period_s,
        stop=stop,
        on_samples=on_samples,
        on_progress=on_progress,
        limits=limits,
    )
    buffer = None
    if Mode(mode) is Mode.CAPTURED:
        if device.buffer is None:
            raise ConfigurationError(
                f"{device.tag}: map {device.unit.map.name} cannot capture: say acquisition.mode = polled"
            )
        buffer = device.buffer
    on_progress(0.0, "checking")
    identity = await device.identify()
    entry = await device.read()
    if not math.isfinite(entry.output_pa):
        raise DeviceError(f"{device.tag}: {device.unit.subject} does not show its output: nothing is moved from there")
    if device.wiring.safe_value_pa == "entry":
        device.safe_value_pa = entry.output_pa
    if buffer is not None:
        await buffer.check(waveform, play.samples)
    if on_ready is not None:
        await on_ready(entry.output_pa, identity)
    await _take(device, run_number)
    about = replace(
        provenance,
        tag=device.tag,
        sequence=provenance.sequence or waveform.name,
        device=identity,
        requested_period_s=period_s,
    )
    return await play.run(buffer, about)


async def _take(device: ValveDevice, run_number: int) -> None:
    await device.take_ownership(run_number)
    try:
        await device.arm_watchdog()
    except ValveError:
        with contextlib.suppress(EquipmentError):
            await device.release()
        raise


class _Play:
    """One test under way."""

    def __init__(
        self,
        *,
        device: ValveDevice,
        waveform: Waveform,
        period_s: float,
        stop: asyncio.Event,
        on_samples: OnSamples,
        on_progress: OnProgress,
        limits: MotionLimits,
    ) -> None:
        self.samples = math.floor(waveform.duration_s / period_s + 1.0e-6) + 1
        self._device = device
        self._waveform = waveform
        self._period_s = period_s
        self._stop = stop
        self._on_samples = on_samples
        self._on_progress = on_progress
        self._limits = limits
        ramps_s = 2.0 * (limits.pressure_pa[1] - limits.pressure_pa[0]) / limits.pressure_rate_pa_per_s
        self._rules = AbortRules(device, limits, waveform.duration_s + ramps_s, period_s)
        self._polled: PolledRows | None = None
        self._notes: list[str] = []

    async def run(self, buffer: CaptureBuffer | None, provenance: Provenance) -> PlayOutcome:
        """Move, make safe, fetch, let go."""
        try:
            ended, error = await self._move(buffer)
            safe = ended is Ended.COMPLETED and await self._device.shows(self._device.safe_value_pa)
            safe = safe or await self._device.go_safe()
            recording: Recording | None = None
            if buffer is None:
                recording = None if self._polled is None else self._polled.recording(provenance)
            elif safe:
                ended, error, recording = await self._fetch(buffer, provenance, ended, error)
        except asyncio.CancelledError:
            await asyncio.shield(self._abandon())
            raise
        await self._let_go(safe)
        self._on_progress(1.0, "ended")
        return PlayOutcome(recording, ended, safe, error, tuple(self._notes))

    async def _abandon(self) -> None:
        await self._let_go(await self._device.go_safe())

    async def _let_go(self, safe: bool) -> None:
        """Write for the last time. A valve that is not known to be safe keeps its watchdog."""
        if not safe:
            self._notes.append("the safe value was not read back: the device's watchdog stays armed")
            return
        try:
            await self._device.release()
        except EquipmentError as error:
            self._notes.append(f"the device was not released: {error}")

    async def _move(self, buffer: CaptureBuffer | None) -> tuple[Ended, ValveError | None]:
        try:
            self._on_progress(0.01, "ramping")
            await self._ramp_to(float(self._waveform.pressure_pa[0]))
            if buffer is None:
                await self._poll()
            else:
                await self._watch(buffer)
            self._on_progress(_PLAY_TO if buffer else _POLLED_TO, "returning")
            await self._ramp_to(self._device.safe_value_pa)
        except _StopError:
            return Ended.STOPPED, None
        except ValveError as error:
            return Ended.FAILED, error
        return Ended.COMPLETED, None

    async def _pause_until(self, until_s: float) -> None:
        delay_s = until_s - time.monotonic()
        if delay_s > 0.0:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(delay_s):
                    await self._stop.wait()
        if self._stop.is_set():
            raise _StopError

    async def _step(self, pressure_pa: float) -> Sample | None:
        """Command, look, judge. None where the wire failed this time; raises where the test must end."""
        device = self._device
        sample: Sample | None = None
        try:
            if math.isnan(device.in_force_pa):
                device.adopt(await device.read())
            self._rules.commanded(pressure_pa)
            await device.drive(pressure_pa)
            await device.feed_watchdog()
            sample = await device.read()
        except EquipmentError as error:
            self._rules.missed(error)
        fault = self._rules.fault(sample)
        if fault is not None:
            raise fault
        return sample

    async def _ramp_to(self, target_pa: float) -> None:
        """Go from where the output is to ``target_pa`` at no more than the allowed rate, and see it there."""
        from_pa = await self._present_output_pa()
        start_s = time.monotonic()
        pressure_pa = from_pa
        while pressure_pa != target_pa:
            reach_pa = self._limits.pressure_rate_pa_per_s * (time.monotonic() - start_s)
            pressure_pa = from_pa + min(max(target_pa - from_pa, -reach_pa), reach_pa)
            await self._step(pressure_pa)
            if pressure_pa != target_pa:
                await self._pause_until(time.monotonic() + _RAMP_PERIOD_S)
        if self._stop.is_set():
            raise _StopError
        self._rules.commanded(target_pa)
        await self._device.command(target_pa)

    async def _present_output_pa(self) -> float:
        while True:
            try:
                return (await self._device.read()).output_pa
            except EquipmentError as error:
                self._rules.missed(error)
            fault = self._rules.fault(None)
            if fault is not None:
                raise fault

    # ---- polled

    async def _poll(self) -> None:
        """Command and look once a slot of a fixed grid; a slot that is missed is not made up for."""
        start_s = time.monotonic()
        self._polled = rows = PolledRows(start_s)
        slot, told_s = 0, start_s
        while slot < self.samples:
            await self._pause_until(start_s + slot * self._period_s)
            begun_s = time.monotonic()
            try:
                sample = await self._step(float(self._waveform.at(begun_s - start_s)))
            except BaseException:
                self._tell(rows, slot)
                raise
            now_s = time.monotonic()
            if sample is None:
                rows.add_gap(begun_s, now_s)
            else:
                rows.add(sample, self._device.in_force_pa)
            slot = max(slot + 1, math.floor((now_s - start_s) / self._period_s + 0.5))
            if now_s - told_s >= _WATCH_PERIOD_S or slot >= self.samples:
                told_s = now_s
                self._tell(rows, slot)

    def _tell(self, rows: PolledRows, slot: int) -> None:
        fresh = rows.fresh()
        if fresh is not None:
            self._on_samples(fresh)
        share = min(1.0, slot / self.samples)
        self._on_progress(_PLAY_FROM + (_POLLED_TO - _PLAY_FROM) * share, "playing")

    # ---- captured

    async def _watch(self, buffer: CaptureBuffer) -> None:
        """Let the device play; look at it now and then, keep its watchdog fed, and end with it."""
        device = self._device
        async for _ in buffer.hand_over(self._waveform, self._period_s, self.samples, device.run_number):
            await device.feed_watchdog()
        await buffer.start()
        device.in_force_pa = math.nan
        while True:
            await self._pause_until(time.monotonic() + _WATCH_PERIOD_S)
            sample: Sample | None = None
            progress: Progress | None = None
            try:
                await device.feed_watchdog()
                progress = await buffer.progress()
                sample = await device.read()
            except EquipmentError as error:
                self._rules.missed(error)
            fault = self._rules.fault(sample, follows=False)
            if fault is not None:
                raise fault
            if sample is None or progress is None:
                continue
            self._on_samples(_glimpse(sample, progress.taken * self._period_s))
            share = min(1.0, progress.taken / self.samples)
            self._on_progress(_PLAY_FROM + (_PLAY_TO - _PLAY_FROM) * share, "playing")
            if progress.done:
                return
            if not progress.running:
                raise DeviceError(
                    f"{device.tag}: the device ended its capture after {progress.taken} samples by itself"
                )

    async def _fetch(
        self, buffer: CaptureBuffer, provenance: Provenance, ended: Ended, error: ValveError | None
    ) -> tuple[Ended, ValveError | None, Recording | None]:
        """Fetch the samples; the valve rests at its safe value meanwhile."""
        rows = CapturedRows(self._period_s)
        try:
            taken = (await buffer.progress()).taken
            ready: list[SampleBlock] = []
            async for window in buffer.windows(min(taken, self.samples)):
                ready.append(rows.add(window))
                if len(ready) == _UPLOAD_BLOCK:
                    self._hand_on(ready, window.first / max(1, taken))
                    await self._device.feed_watchdog()
            self._hand_on(ready, 1.0)
        except EquipmentError as fault:
            if ended is Ended.COMPLETED:
                ended, error = Ended.FAILED, fault
            else:
                self._notes.append(f"the samples were not all fetched: {fault}")
        return ended, error, rows.recording(provenance)

    def _hand_on(self, ready: list[SampleBlock], share: float) -> None:
        if ready:
            self._on_samples(_joined(ready))
            ready.clear()
        self._on_progress(_PLAY_TO + (1.0 - _PLAY_TO) * share, "uploading")


def _glimpse(sample: Sample, time_s: float) -> SampleBlock:
    """One look at a captured test: for the eye, not for the recording."""
    time, position, pressure, command = np.array(
        [[time_s], [sample.position_m], [sample.pressure_pa], [sample.output_pa]], dtype=np.float64
    )
    return SampleBlock(time, position, pressure, command, sent_s=None, received_s=None, recorded=False)


def _joined(blocks: list[SampleBlock]) -> SampleBlock:
    return SampleBlock(
        np.concatenate([block.time_s for block in blocks]),
        np.concatenate([block.position_m for block in blocks]),
        np.concatenate([block.pressure_pa for block in blocks]),
        np.concatenate([block.command_pa for block in blocks]),
        None,
        None,
        recorded=True,
    )
