"""One test on one valve: from its present output to the waveform, along it, and to the safe value however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from dataclasses import replace

from drivers.abort_rules import AbortRules
from drivers.addresses import Mode, MotionLimits
from drivers.capture_buffer import CaptureBuffer
from drivers.captured_play import CapturedPlay
from drivers.course import Course
from drivers.device import ValveDevice
from drivers.mover import Mover, StopAskedError
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.polled_play import PolledPlay
from drivers.waveform_check import check_waveform
from valve.errors import ConfigurationError, DeviceError, EquipmentError, ValveError
from valve.recording import Provenance
from valve.waveform import Waveform

OnSamples = Callable[[SampleBlock], None]
OnProgress = Callable[[float, str], None]
OnReady = Callable[[float, str], Awaitable[None]]

_PLAY_FROM, _PLAY_TO, _POLLED_TO = 0.05, 0.8, 0.95  # shares of the progress


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
    buffer = None
    if Mode(mode) is Mode.CAPTURED:
        if device.buffer is None:
            raise ConfigurationError(
                f"{device.tag}: map {device.unit.map.name} cannot capture: say acquisition.mode = polled"
            )
        buffer = device.buffer
    play = _Play(
        device=device,
        waveform=waveform,
        period_s=period_s,
        buffer=buffer,
        stop=stop,
        on_samples=on_samples,
        on_progress=on_progress,
        limits=limits,
    )
    on_progress(0.0, "checking")
    identity = await device.identify()
    entry = await device.read()
    if not math.isfinite(entry.output_pa):
        raise DeviceError(f"{device.tag}: {device.unit.subject} does not show its output: nothing is moved from there")
    if device.wiring.safe_value_pa == "entry":
        device.safe_value_pa = entry.output_pa
    if buffer is not None:
        await buffer.check(play.course)
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
    return await play.run(about)


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
        buffer: CaptureBuffer | None,
        stop: asyncio.Event,
        on_samples: OnSamples,
        on_progress: OnProgress,
        limits: MotionLimits,
    ) -> None:
        self.course = course = Course(waveform, period_s)
        self._device = device
        self._waveform = waveform
        self._on_progress = on_progress
        self._phase = (_PLAY_FROM, _POLLED_TO if buffer is None else _PLAY_TO, "playing")
        ramps_s = 2.0 * (limits.pressure_pa[1] - limits.pressure_pa[0]) / limits.pressure_rate_pa_per_s
        rules = AbortRules(device, limits, waveform.duration_s + ramps_s, period_s)
        self._mover = Mover(device, rules, stop, limits.pressure_rate_pa_per_s)
        self._captured: CapturedPlay | None = None
        if buffer is not None:
            self._captured = CapturedPlay(buffer, course, on_samples, self._tell)
        self._polled = PolledPlay(course, on_samples, self._tell)
        self._notes: list[str] = []

    def _tell(self, share: float) -> None:
        low, high, phase = self._phase
        self._on_progress(low + (high - low) * share, phase)

    async def run(self, provenance: Provenance) -> PlayOutcome:
        """Move, make safe, fetch, let go."""
        try:
            ended, error = await self._move()
            safe = ended is Ended.COMPLETED and await self._device.shows(self._device.safe_value_pa)
            safe = safe or await self._device.go_safe()
            if self._captured is not None and safe:
                ended, error = await self._fetch(self._captured, ended, error)
        except asyncio.CancelledError:
            await asyncio.shield(self._abandon())
            raise
        recording = (self._polled if self._captured is None else self._captured).recording(provenance)
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

    async def _move(self) -> tuple[Ended, ValveError | None]:
        try:
            self._on_progress(0.01, "ramping")
            await self._mover.ramp_to(float(self._waveform.pressure_pa[0]))
            await (self._polled if self._captured is None else self._captured).play(self._mover)
            self._on_progress(self._phase[1], "returning")
            await self._mover.ramp_to(self._device.safe_value_pa)
        except StopAskedError:
            return Ended.STOPPED, None
        except ValveError as error:
            return Ended.FAILED, error
        return Ended.COMPLETED, None

    async def _fetch(
        self, captured: CapturedPlay, ended: Ended, error: ValveError | None
    ) -> tuple[Ended, ValveError | None]:
        self._phase = (_PLAY_TO, 1.0, "uploading")
        try:
            await captured.fetch(self._mover)
        except EquipmentError as fault:
            if ended is Ended.COMPLETED:
                return Ended.FAILED, fault
            self._notes.append(f"the samples were not all fetched: {fault}")
        return ended, error
