"""One test on one valve: from its present output to the waveform, along it, and to the safe value however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace

from drivers.abort_rules import AbortRules
from drivers.addresses import Mode, MotionLimits
from drivers.capture_buffer import CaptureBuffer
from drivers.captured_play import CapturedPlay
from drivers.course import Course
from drivers.device import ValveDevice
from drivers.faults import StandstillError
from drivers.mover import Mover, StopAskedError
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.permissive_watch import PermissiveWatch
from drivers.permissives import Permissive, Readiness, judge_entry
from drivers.polled_play import PolledPlay
from drivers.waveform_check import check_waveform
from valve.errors import ConfigurationError, DeviceError, EquipmentError, ValveError, WireError
from valve.recording import Provenance
from valve.waveform import Waveform

OnSamples = Callable[[SampleBlock], None]
OnProgress = Callable[[float, str], None]
OnReady = Callable[[float, str], Awaitable[None]]
OnPermissives = Callable[[tuple[Permissive, ...]], None]

_FOLLOWED_S = 5.0  # own choice: the slowest published I/P (0.93 s) is there within half of it
_RELEASE_ATTEMPTS = 3  # it moves nothing, so it may be repeated
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
    permit: str | None = None,
    on_permissives: OnPermissives = lambda _: None,
) -> PlayOutcome:
    """Play ``waveform`` on a valve and record it.

    Everything that can be refused is refused before anything moves, as a ValveError: the waveform against the limits,
    the device's identity, its permissives (``on_permissives`` hears them, met or not), its owner, its watchdog.
    ``on_ready`` is awaited with the output at entry (Pa) and the device's name before the first write. From the first
    move on every end is an outcome: the valve is sent to its safe value, this is read back, and nothing but the
    release is written afterwards; where it is not confirmed the watchdog stays armed. A cancelled caller gets the
    same, then the cancellation.
    """
    check_waveform(device.tag, waveform, limits)
    buffer = None
    if Mode(mode) is Mode.CAPTURED:
        if device.buffer is None:
            raise ConfigurationError(
                f"{device.tag}: map {device.unit.map.name} cannot capture: say acquisition.mode = polled"
            )
        buffer = device.buffer
        period_s = buffer.kept_period_s(period_s)
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
    readiness = await judge_entry(device, permit)
    entry = readiness.entry
    assert entry is not None  # judge_entry raises where there is none
    on_permissives(readiness.permissives)
    readiness.require(device.tag)
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
    return await play.run(about, readiness, permitted=device.wiring.permissives.permit and bool(permit))


async def _take(device: ValveDevice, run_number: int) -> None:
    try:
        await device.take_ownership(run_number)
        await device.arm_watchdog()
    except (WireError, DeviceError, asyncio.CancelledError):
        # Also a take whose answer was lost may have been carried out: nobody else could have the device then.
        await _to_the_end(_released(device, run_number))
        raise


async def _released(device: ValveDevice, run_number: int) -> None:
    for _ in range(_RELEASE_ATTEMPTS):
        with contextlib.suppress(EquipmentError):
            await device.release(run_number)
            return


async def _to_the_end(work: Coroutine[None, None, None]) -> None:
    """Do what must be done also for a caller that is cancelled, and cancelled again."""
    task = asyncio.ensure_future(work)
    while not task.done():
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(task)
    task.result()


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
        # There and back over the whole range, and as long again for a line that is slow.
        ramps_s = 4.0 * (limits.pressure_pa[1] - limits.pressure_pa[0]) / limits.pressure_rate_pa_per_s
        self._rules = AbortRules(device, limits, waveform.duration_s + ramps_s, period_s)
        self._mover = Mover(device, self._rules, stop, limits.pressure_rate_pa_per_s)
        self._captured: CapturedPlay | None = None
        if buffer is not None:
            self._captured = CapturedPlay(buffer, course, on_samples, self._tell)
        self._polled = PolledPlay(course, on_samples, self._tell)
        self._notes: list[str] = []
        self._readiness = Readiness(())
        self._watch: PermissiveWatch | None = None

    def _tell(self, share: float) -> None:
        low, high, phase = self._phase
        self._on_progress(low + (high - low) * share, phase)

    async def run(self, provenance: Provenance, readiness: Readiness, *, permitted: bool) -> PlayOutcome:
        """Move, make safe, fetch, let go."""
        self._readiness, self._watch = readiness, PermissiveWatch(self._device, permitted=permitted)
        try:
            ended, error = await self._move()
            safe = ended is Ended.COMPLETED and await self._device.shows(self._device.safe_value_pa)
            safe = safe or await self._device.go_safe()
            if self._captured is not None and safe:
                ended, error = await self._fetch(self._captured, ended, error)
            played = self._polled if self._captured is None else self._captured
            # In a thread: tests that end together would hold up the valves that still move for 20 ms.
            recording = await asyncio.to_thread(played.recording, provenance)
        except BaseException:
            # A cancelled caller, a full disk under on_samples, a fault of ours: the valve goes to safe all the same.
            await _to_the_end(self._abandon())
            raise
        safe = await self._let_go(safe)
        if safe and ended is Ended.FAILED:
            error = await self._told_without_effect(error)
        self._on_progress(1.0, "ended")
        return PlayOutcome(recording, ended, safe, error, tuple(self._notes), self._device.writes)

    async def _told_without_effect(self, error: ValveError | None) -> ValveError | None:
        """Return the error, with the pressure where it does not follow the device to the safe value.

        What the device shows is what it asks of the I/P; an I/P that has run away, or lost its air, does not do it.
        """
        device = self._device
        with contextlib.suppress(EquipmentError):
            stays_pa = await device.pressure_apart(_FOLLOWED_S)
            if math.isfinite(stays_pa):
                return DeviceError(
                    f"{error}; the device shows its safe value of {device.safe_value_pa:.4g} Pa, and the actuator's "
                    f"pressure stays at {stays_pa:.4g} Pa: keep away from the valve, and look at its I/P and air supply"
                )
        return error

    async def _abandon(self) -> None:
        await self._let_go(await self._device.go_safe())

    async def _let_go(self, safe: bool) -> bool:
        """Write for the last time. A valve that is not known to be safe keeps its watchdog.

        Where a fence closed behind the last write, what is read then is final, and is returned.
        """
        device = self._device
        if not safe:
            self._notes.append("the safe value was not read back: the device's watchdog stays armed")
            return False
        try:
            await device.release()
        except EquipmentError as error:
            self._notes.append(f"the device was not released: {error}")
            return True
        if device.unit.map.fence is None or await device.shows(device.safe_value_pa, reads=1):
            return True
        self._notes.append("after the release the device no longer shows the safe value: a late write reached it")
        return False

    async def _move(self) -> tuple[Ended, ValveError | None]:
        try:
            if self._captured is not None:
                self._on_progress(0.005, "handing over")
                await self._captured.hand_over(self._mover)
            self._on_progress(0.01, "ramping")
            self._rules.begin(self._readiness.entry, self._readiness.unrest_m, self._watch)
            await self._mover.ramp_to(float(self._waveform.pressure_pa[0]))
            await (self._polled if self._captured is None else self._captured).play(self._mover)
            self._on_progress(self._phase[1], "returning")
            await self._mover.ramp_to(self._device.safe_value_pa)
        except StopAskedError:
            return Ended.STOPPED, None
        except StandstillError as error:
            await self._ramp_back()
            return Ended.FAILED, error
        except ValveError as error:
            return Ended.FAILED, error
        return Ended.COMPLETED, None

    async def _ramp_back(self) -> None:
        """Take the pressure back at the allowed rate; a stop, or another fault, sends the valve to safe at once."""
        self._on_progress(self._phase[1], "ramping back")
        self._rules.stand_down()
        with contextlib.suppress(StopAskedError, ValveError):
            await self._mover.ramp_to(self._device.safe_value_pa)

    async def _fetch(
        self, captured: CapturedPlay, ended: Ended, error: ValveError | None
    ) -> tuple[Ended, ValveError | None]:
        self._phase = (_PLAY_TO, 1.0, "uploading")
        try:
            note = await captured.fetch(self._mover)
            if note:
                self._notes.append(note)
                ended = Ended.STOPPED if ended is Ended.COMPLETED else ended
        except EquipmentError as fault:
            if ended is Ended.COMPLETED:
                return Ended.FAILED, fault
            self._notes.append(f"the samples were not all fetched: {fault}")
        return ended, error
