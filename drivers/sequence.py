"""One test on one valve: from its present output to the waveform, along it, and to the safe value however it ends."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import replace
from typing import TypeVar

from drivers.abort_rules import AbortRules
from drivers.addresses import Mode, MotionLimits
from drivers.capture_buffer import CaptureBuffer
from drivers.captured_play import CapturedPlay
from drivers.course import Course
from drivers.device import ValveDevice
from drivers.faults import StandstillError
from drivers.mover import Mover, OldPermissivesError, StopAskedError
from drivers.outcome import Ended, PlayOutcome, SafeOutcome, Sample, SampleBlock
from drivers.permissive import Permissive
from drivers.permissive_watch import PermissiveWatch
from drivers.permissives import FRESH_S, Readiness, judge_entry
from drivers.polled_play import PolledPlay
from drivers.recent import window_s
from drivers.rest_look import seen_last
from drivers.waveform_check import check_waveform
from valve.errors import BusyError, ConfigurationError, DeviceError, EquipmentError, PermissiveError, ValveError
from valve.messages import message_of, say
from valve.recording import Provenance
from valve.waveform import Waveform

_LOG = logging.getLogger(__name__)
_Result = TypeVar("_Result")
OnSamples = Callable[[SampleBlock], None]
OnProgress = Callable[[float, str], None]
OnReady = Callable[[float, str], Awaitable[None]]
OnIntent = Callable[[], Awaitable[None]]
OnPermissives = Callable[[tuple[Permissive, ...]], None]

_FOLLOWED_S = 5.0  # own choice: the slowest published I/P (0.93 s) is there within half of it
_FRESH_READS = 3
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
    on_intent: OnIntent | None = None,
    permit: str | None = None,
    on_permissives: OnPermissives = lambda _: None,
    enough: asyncio.Event | None = None,
) -> PlayOutcome:
    """Play ``waveform`` on a valve and record it.

    Everything that can be refused is refused before anything moves, as a ValveError: the waveform against the limits,
    the device's identity, its permissives (``on_permissives`` hears them, met or not), its owner, its watchdog. The
    permissives are read once more when all that takes time is done, and the first write follows at once.
    ``on_ready`` is awaited with the output at entry (Pa) and the device's name before the first write, ``on_intent``
    when the device is ours and before the first write that can move the valve: it must be on disk when that returns.
    ``device.commanded`` tells, also where this raises, whether such a write went out. From the first
    move on every end is an outcome: the valve is sent to its safe value, this is read back, and nothing but the
    release is written afterwards; where it is not confirmed the watchdog stays armed. A cancelled caller gets the
    same, then the cancellation.
    ``enough``, for polled tests, ends the waveform once it is set; the test completes by the ramp that follows each
    waveform. A stop at the same moment wins.
    """
    check_waveform(device.tag, waveform, limits)
    buffer = None
    if Mode(mode) is Mode.CAPTURED:
        if enough is not None:
            raise ConfigurationError(
                say(
                    "captured_cannot_end_early",
                    "{tag}: a captured test is played by the device to its end: to end it once enough is known, "
                    "say acquisition.mode = polled",
                    tag=device.tag,
                )
            )
        if device.buffer is None:
            raise ConfigurationError(
                say(
                    "map_cannot_capture",
                    "{tag}: map {map} cannot capture: say acquisition.mode = polled",
                    tag=device.tag,
                    map=device.unit.map.name,
                )
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
        permitted=device.wiring.permissives.permit and bool(permit),
        enough=enough,
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
    await _take(device, run_number, on_intent)
    about = replace(
        provenance,
        tag=device.tag,
        sequence=provenance.sequence or waveform.name,
        device=identity,
        requested_period_s=period_s,
    )
    return await play.run(about, entry, permit)


async def _take(device: ValveDevice, run_number: int, on_intent: OnIntent | None) -> None:
    try:
        await device.take_ownership(run_number)
        await device.arm_watchdog()
        if on_intent is not None:
            await on_intent()
    except BusyError:
        raise  # it is another run's: there is nothing to give back
    except BaseException as error:
        # Also a take whose answer was lost may have been carried out: nobody else could have the device then.
        kept = await _to_the_end(_released(device, run_number))
        if kept and isinstance(error, ValveError):
            raise DeviceError(
                say(
                    "may_stay_owned",
                    "{why}; {device} may stay with run {run}: {not_released}",
                    why=message_of(error),
                    device=device.unit.subject,
                    run=run_number,
                    not_released=kept,
                )
            ) from error
        raise


async def _released(device: ValveDevice, run_number: int) -> str:
    """Give a device back; return why that failed, "" where it did not."""
    reason = ""
    for _ in range(_RELEASE_ATTEMPTS):
        try:
            await device.release(run_number)
        except EquipmentError as error:
            reason = message_of(error)
        else:
            return ""
    _LOG.error("%s: the device was not released: %s", device.tag, reason)
    return reason


async def _over(watching: asyncio.Future[None]) -> None:
    """Wait for the last reading of a watch that was told to end; what fails in it was judged as not read."""
    with contextlib.suppress(Exception):
        await watching


async def _to_the_end(work: Coroutine[None, None, _Result], on_cancelled: Callable[[], None] = lambda: None) -> _Result:
    """Do what must be done also for a caller that is cancelled, and cancelled again; return what came of it.

    ``on_cancelled`` is called where it is. The cancellation goes no further: the caller raises it, or what it was for
    is done.
    """
    task = asyncio.ensure_future(work)
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError:
            on_cancelled()
        except Exception:  # noqa: BLE001  - it stands in the task, and is raised below
            break
    return task.result()


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
        permitted: bool,
        enough: asyncio.Event | None,
    ) -> None:
        self.course = course = Course(waveform, period_s)
        self._device = device
        self._waveform = waveform
        self._on_progress = on_progress
        self._phase = (_PLAY_FROM, _POLLED_TO if buffer is None else _PLAY_TO, "playing")
        # There and back over the whole range, and as long again for a line that is slow.
        ramps_s = 4.0 * (limits.pressure_pa[1] - limits.pressure_pa[0]) / limits.pressure_rate_pa_per_s
        self._rules = AbortRules(device, limits, waveform.duration_s + ramps_s, period_s)
        wake = asyncio.Event()
        self._mover = Mover(device, self._rules, stop, wake, limits.pressure_rate_pa_per_s)
        self._captured: CapturedPlay | None = None
        if buffer is not None:
            self._captured = CapturedPlay(buffer, course, on_samples, self._tell)
        self._polled = PolledPlay(course, on_samples, self._tell, enough)
        self._notes: list[str] = []
        self._stop, self._wake = stop, wake
        self._watch = PermissiveWatch(device, permitted=permitted, within_s=window_s(period_s), on_lost=wake.set)

    def _tell(self, share: float) -> None:
        low, high, phase = self._phase
        self._on_progress(low + (high - low) * share, phase)

    async def run(self, provenance: Provenance, entry: Sample, permit: str | None) -> PlayOutcome:
        """Move, make safe, fetch, let go; ``entry`` is how the valve stood when its safe value was chosen."""
        watching, hearing = asyncio.ensure_future(self._watch.run()), asyncio.ensure_future(self._hear_stop())
        try:
            ended, error = await self._move(entry, permit)
        except BaseException:
            # A cancelled caller, a full disk under on_samples, a fault of ours: the valve goes to safe all the same.
            await _to_the_end(self._abandon(watching))
            raise
        finally:
            hearing.cancel()
        # From here on a cancellation is heard as a stop: neither what was recorded nor how the valve stands is lost.
        return await _to_the_end(self._rest(ended, error, provenance, watching), self._stop.set)

    async def _hear_stop(self) -> None:
        await self._stop.wait()
        self._wake.set()

    async def _rest(
        self, ended: Ended, error: ValveError | None, provenance: Provenance, watching: asyncio.Future[None]
    ) -> PlayOutcome:
        """See the valve at its safe value, fetch, let go."""
        device = self._device
        self._watch.end()
        try:
            safe = SafeOutcome(False)
            if ended is Ended.COMPLETED:
                safe = await device.confirmation(device.safe_value_pa)
            if not safe.confirmed:
                safe = await device.go_safe()
            if safe.confirmed:
                self._on_progress(self._phase[1], "at its safe value")  # whoever stopped it waits for nothing else
            if self._captured is not None and safe.confirmed:
                ended, error = await self._fetch(self._captured, ended, error)
            played = self._polled if self._captured is None else self._captured
            # In a thread: tests that end together would hold up the valves that still move for 20 ms.
            recording = await asyncio.to_thread(played.recording, provenance)
        except BaseException:
            await self._abandon(watching)
            raise
        safe = await self._let_go(safe)
        confirmed = safe.confirmed
        await _over(watching)
        if confirmed and ended is Ended.FAILED:
            error = await self._told_without_effect(error)
        self._on_progress(1.0, "ended")
        stands = seen_last(device, confirmed=confirmed)
        return PlayOutcome(
            recording,
            ended,
            confirmed,
            error,
            tuple(self._notes),
            device.writes,
            device.commanded,
            stands,
            safe.reason,
            self._polled.ended_early_s if ended is Ended.COMPLETED else None,
        )

    async def _told_without_effect(self, error: ValveError | None) -> ValveError | None:
        """Return the error, with the pressure where it does not follow the device to the safe value.

        What the device shows is what it asks of the I/P; an I/P that has run away, or lost its air, does not do it.
        """
        device = self._device
        with contextlib.suppress(EquipmentError):
            stays_pa = await device.pressure_apart(_FOLLOWED_S)
            if math.isfinite(stays_pa):
                return DeviceError(
                    say(
                        "pressure_stays",
                        "{why}; the device shows its safe value of {safe:.4g Pa}, and the actuator's pressure stays "
                        "at {pressure:.4g Pa}: keep away from the valve, and look at its I/P and air supply",
                        why="" if error is None else message_of(error),
                        safe=device.safe_value_pa,
                        pressure=stays_pa,
                    )
                )
        return error

    async def _abandon(self, watching: asyncio.Future[None]) -> None:
        """Make safe and let go; a valve to which nothing was sent stays as it is."""
        self._watch.end()
        if self._device.commanded:
            safe = await self._device.go_safe()
            if not safe.confirmed:
                _LOG.error("%s: safe state not confirmed: %s", self._device.tag, safe.reason)
            await self._let_go(safe)
        else:
            await _released(self._device, self._device.run_number)
        await _over(watching)

    async def _let_go(self, safe: SafeOutcome) -> SafeOutcome:
        """Write for the last time. A valve that is not known to be safe keeps its watchdog.

        Where a fence closed behind the last write, what is read then is final, and is returned.
        """
        device = self._device
        if not safe.confirmed:
            self._notes.append(
                say(
                    "safe_not_read_back",
                    "the safe value was not read back ({why}): the device's watchdog stays armed",
                    why=safe.reason,
                )
            )
            return safe
        kept = await _released(device, device.run_number)
        if kept:
            self._notes.append(say("not_released", "the device was not released: {why}", why=kept))
            return safe
        if device.unit.map.fence is None:
            return safe
        final = await device.confirmation(device.safe_value_pa, reads=1)
        if not final.confirmed:
            self._notes.append(
                say(
                    "safe_left_after_release",
                    "after the release the device no longer shows the safe value, as where a late write reached "
                    "it: {why}",
                    why=final.reason,
                )
            )
        return final

    async def _ready(self, entry: Sample, permit: str | None) -> Readiness:
        """Read the permissives that the first write follows.

        Raises PermissiveError where one does not hold any more, or the safe value at entry is no longer that.
        """
        device = self._device
        self._mover.require_no_stop()
        readiness = await judge_entry(device, permit, feed=True)
        readiness.require(device.tag)
        now = readiness.entry
        assert now is not None  # judge_entry raises where there is none
        away_pa = abs(now.output_pa - entry.output_pa)
        if device.wiring.safe_value_pa == "entry" and away_pa > device.tolerance_pa:
            raise PermissiveError(
                say(
                    "output_moved_meanwhile",
                    "{tag}: nothing was moved: the output at entry is the safe value, and it went from "
                    "{entry:g in Pa} to {now:g Pa} meanwhile: check who commands the valve, then start again",
                    tag=device.tag,
                    entry=entry.output_pa,
                    now=now.output_pa,
                )
            )
        self._mover.require_no_stop()
        self._rules.begin(now, readiness.unrest_m, self._watch)
        self._mover.first_before_s = readiness.fresh_until_s
        return readiness

    async def _begin(self, entry: Sample, permit: str | None) -> None:
        """Hand over what the device plays by itself, then go to the waveform's start by permissives that are fresh."""
        if self._captured is not None:
            self._on_progress(0.005, "handing over")
            await self._captured.hand_over(self._mover)
        for _ in range(_FRESH_READS):
            now = (await self._ready(entry, permit)).entry
            self._on_progress(0.01, "ramping")
            try:
                await self._mover.ramp_to(float(self._waveform.pressure_pa[0]), None if now is None else now.output_pa)
            except OldPermissivesError:
                continue
            return
        raise PermissiveError(
            say(
                "permissives_too_old",
                "{tag}: nothing was moved: the permissives were older than {time:g s} before the first "
                "write, {times} times: this machine or the bus is too busy, start again",
                tag=self._device.tag,
                time=FRESH_S,
                times=_FRESH_READS,
            )
        )

    async def _move(self, entry: Sample, permit: str | None) -> tuple[Ended, ValveError | None]:
        try:
            await self._begin(entry, permit)
            await (self._polled if self._captured is None else self._captured).play(self._mover)
            self._on_progress(self._phase[1], "returning")
            await self._mover.ramp_to(self._device.safe_value_pa)
        except StopAskedError:
            return Ended.STOPPED, None
        except StandstillError as error:
            await self._ramp_back()
            return Ended.FAILED, error
        except ValveError as error:
            if not self._device.commanded:
                raise  # nothing was moved, and nothing will be
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
            self._notes.append(
                say("samples_not_fetched", "the samples were not all fetched: {why}", why=message_of(fault))
            )
        return ended, error
