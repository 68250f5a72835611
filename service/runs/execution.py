"""The execution of one run, from its intent on disk to its result on disk."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import structlog
from sqlalchemy.exc import OperationalError

from drivers.addresses import Mode
from drivers.motion.orders import Armed, Heard, MotionEnd, MotionLink, MotionLostError, Order
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.stands_at import StandsAt
from service.config.plant import PlantValve
from service.model.analysis import analysis_failed
from service.model.family_rule import OUT_OF_FAMILY_KEY
from service.model.run import ENDED_EARLY_KEY, ENDED_KEY, RunState
from service.model.stands_words import NOT_CONFIRMED
from service.model.until import UNTIL_KEY
from service.runs.analyst import Analyst, assessed
from service.runs.bus_owners import BusOwners, Claim
from service.runs.left_journal import shown_commanded
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.live_estimates import LiveEstimates
from service.runs.permission import Permission
from service.runs.quality import recording_quality
from service.runs.stem_looks import Rest, StemLooks
from service.store.store import Store
from service.workers.polling import Polling
from valve.errors import InternalError, MeasurementError, ValveError
from valve.messages import joined, message_of, report_it, say

_LOG = structlog.get_logger(__name__)
_OF_SERVICE: Final = ("disk", "last_test")
# The phase in which a device's own samples are fetched: only then, and only where the valve was read back at safe.
UPLOADING: Final = "uploading"
RETURNING: Final = "returning"  # the sequence is over, and the valve on its way to its safe value
AT_SAFE: Final = "at its safe value"  # it was read back; the recording is still to be made
_BACK_S: Final = 15.0  # for a motion process to be there again
ENDED: Final = "ended"  # however it did: no sign of how much was done


OnSamples = Callable[[str, SampleBlock], None]  # a valve's tag and samples of it that were written down


class Execution:
    """Carries one order out. The claim is given back as soon as the valve rests and its recording is on disk."""

    def __init__(
        self,
        live: LiveRun,
        valve: PlantValve,
        order: Order,
        claim: Claim,
        *,
        store: Store,
        owners: BusOwners,
        looks: StemLooks,
        together: Sequence[str] = (),
        on_samples: OnSamples = lambda *_: None,
        estimates: LiveEstimates | None = None,
    ) -> None:
        self._estimates = estimates
        self._looks = looks
        self._at_rest_s: float | None = None  # when the valve was brought to its safe value (monotonic)
        self._is_given_back = False
        self._on_kept = on_samples
        self._together = tuple(together)
        self._live = live
        self._valve = valve
        self._order = order
        self._claim = claim
        self._store = store
        self._owners = owners
        self._playing: asyncio.Future[MotionEnd] | None = None
        self._permissives: dict[str, Any] | None = None  # as they held when the motion was about to begin
        self._storing_permissives: asyncio.Task[None] | None = None
        #: False where the end stands in memory alone, as the store could not be written.
        self.is_end_stored = True
        #: Whether the program that moves valves ended, or this one while that goes on: the end is open, nothing stored.
        self.is_lost = False
        self.is_left = False
        self._is_rejoined = False  # its motion was begun on another connection
        self._entry_pa: float | None = None
        self._faults: tuple[str, ...] = ()
        self._commanded = False  # whether anything was sent that can move the valve

    async def run(self, motion: MotionLink, analyst: Analyst, *, polling: Polling, rejoined: bool = False) -> None:
        """Move, record, analyse; every way it can end is stored in the run. ``rejoined`` where it moves already.

        A cancellation ends the motion, and its outcome and recording are stored all the same before it goes on; it
        leaves a motion that outlives this process alone.
        """
        try:
            is_polled = self._valve.wiring.acquisition.mode is Mode.POLLED
            moved = self._moved(motion, polling.motion() if is_polled else nullcontext(), rejoined=rejoined)
            if await self._to_its_end(moved, outlived=motion.outlives_us):
                await self._analyze(analyst)
        except Exception as error:  # noqa: BLE001  - here a test's failure is stored
            await self._failed(error)
        finally:
            if self._estimates is not None:
                self._estimates.end()
            if not (self.is_lost or self.is_left):
                self._forget(motion)
                self._live.at_rest.set()
                self._live.motion_ended.set()
                self._give_back()

    def _forget(self, motion: MotionLink) -> None:
        if self.is_end_stored:
            try:
                motion.forget(self._live.run.id)
            except MotionLostError as error:  # the next start finds it once more
                _LOG.warning("end of a motion not removed", test=self._live.run.id, error=str(error))

    def _give_back(self) -> None:
        """Give the valve back: at once where nothing was commanded, else as soon as its stem was looked at."""
        if self._is_given_back:
            return
        self._is_given_back = True
        if self._commanded:
            self._looks.begin(self._rest(self._live.run.safe_confirmed))
        else:
            self._owners.release(self._claim)

    def _rest(self, confirmed: bool | None) -> Rest:
        """Return the valve as the motion leaves it; ``confirmed``: whether its safe value was read back."""
        if self._at_rest_s is None:
            self._at_rest_s = time.monotonic()
        safe = self._valve.wiring.safe_value_pa
        safe_pa = self._entry_pa if isinstance(safe, str) else safe
        return Rest(self._live.run, self._valve, self._claim, self._at_rest_s, safe_pa, bool(confirmed), self._live)

    async def _to_its_end(self, moved: Coroutine[Any, Any, bool], *, outlived: bool) -> bool:
        """Wait for a motion and what is stored of it; a cancellation is handed to the motion, then to the caller."""
        task, cancelled = asyncio.ensure_future(moved), False
        while not task.done():
            try:
                await asyncio.shield(task)
            except asyncio.CancelledError:
                cancelled = True
                if not outlived or self._playing is None:  # nothing was asked of the motion process yet
                    self._live.request_stop(say("stopped_service_ended", "stopped: the service ended"))
                if self._playing is not None:
                    self._playing.cancel()
        if cancelled:
            raise asyncio.CancelledError
        return task.result()

    async def _moved(self, motion: MotionLink, polled: AbstractContextManager[None], *, rejoined: bool) -> bool:
        try:
            with polled:
                return await self._move(motion, rejoined=rejoined)
        except MotionLostError as error:
            _LOG.error("motion lost", test=self._live.run.id, valve=self._live.run.valve, error=str(error))
            self.is_lost = True
        except Exception as error:  # noqa: BLE001  - here a test's failure is stored
            await self._failed(error)
        except asyncio.CancelledError:
            if motion.outlives_us:
                self.is_left = True
            else:
                await self._close(say("cancelled_as_service_ended", "the test was cancelled as the service ended"))
        return False

    async def _failed(self, error: Exception) -> None:
        _LOG.error("test failed unexpectedly", test=self._live.run.id, valve=self._live.run.valve, exc_info=error)
        await self._close(joined("; ", (*self._faults, _reason(error))))

    def _tell_rest(self, *, confirmed: bool, stands: StandsAt | None = None) -> None:
        """Let whoever stopped the test hear that its valve was brought to rest, whatever the store does now."""
        self._live.run = replace(self._live.run, safe_confirmed=confirmed)
        if self._commanded:
            self._live.show_stands(stands or self._rest(confirmed).moving())
        self._live.at_rest.set()

    async def _close(self, reason: str) -> None:
        """Store an end that was not foreseen."""
        safe = self._live.run.safe_confirmed
        if self._commanded and safe is None:
            safe = False
        if not self._commanded:
            reason = _nothing_moved(reason)
        reasons = [NOT_CONFIRMED, reason] if safe is False else [reason]
        changes: dict[str, Any] = {"error": joined("; ", reasons), "finished_at": datetime.now(UTC)}
        changes |= {"safe_confirmed": safe, "commanded": self._commanded}
        if self._commanded and self._live.run.stands is None:
            changes["stands"] = self._rest(safe).moving()
        try:
            await self._end(RunState.FAILED, **changes)
        except Exception as error:  # noqa: BLE001  - nobody may wait for ever for an end that cannot be stored
            _LOG.error("end of test not stored", test=self._live.run.id, exc_info=error)
            self.is_end_stored = False
            self._live.run = replace(self._live.run, state=RunState.FAILED, **changes)
            self._live.announce()

    async def _change(self, **changes: Any) -> None:
        """Store the changed run, then let it be seen: nobody hears of what a crash could undo."""
        async with self._live.storing:
            await asyncio.to_thread(self._store.runs.save, replace(self._live.run, **changes))
            self._live.run = replace(self._live.run, **changes)
            self._live.announce()

    async def _end(self, state: RunState, error: str = "", **changes: Any) -> None:
        await self._change(**{"state": state, "error": error, "finished_at": datetime.now(UTC), **changes})
        _LOG.info("test ended", test=self._live.run.id, valve=self._live.run.valve, state=state.value, error=error)

    async def _move(self, motion: MotionLink, *, rejoined: bool) -> bool:
        """Drive the valve and store what was recorded; True where there is something to analyse."""
        live = self._live
        self._is_rejoined = rejoined
        if not rejoined:
            if not live.stop.is_set():
                await self._change(state=RunState.RUNNING, started_at=datetime.now(UTC))
            if live.stop.is_set():
                await self._end(RunState.STOPPED, live.stop_reason, commanded=False)
                return False
        heard = Heard(self._on_armed, self._on_samples, self._on_progress, self._on_commanded)
        order = replace(self._order, started_at=(live.run.started_at or live.run.created_at).isoformat())
        telling = [asyncio.create_task(self._tell_stop(motion))]
        if order.may_end_early and self._estimates is not None:
            telling.append(asyncio.create_task(self._tell_enough(motion, self._estimates)))
        try:
            end = await self._heard_out(motion, order, heard, rejoined=rejoined)
        except MotionLostError:
            raise
        except ValveError as error:
            if self._is_rejoined and await asyncio.to_thread(shown_commanded, self._store, live.run) is not False:
                self._commanded = True
                raise  # something was sent, and how it ended cannot be told
            await self._end(RunState.FAILED, _nothing_moved(message_of(error)), commanded=False)
            return False
        finally:
            for task in telling:
                task.cancel()
        self._entry_pa, self._faults = end.entry_pa, end.faults
        self._note(end.outcome)
        await self._permissives_stored()
        await self._store_end(end)
        self._forget(motion)
        live.motion_ended.set()
        self._give_back()
        return live.run.state is RunState.ANALYZING

    async def _heard_out(self, motion: MotionLink, order: Order, heard: Heard, *, rejoined: bool) -> MotionEnd:
        """Return the end of the motion; where the connection alone broke it is heard on.

        Raises MotionLostError where the motion process knows nothing of it any more, or does not come back.
        """
        while True:
            going = motion.rejoin(order.run_id, heard) if rejoined else motion.play(order, heard)
            self._playing = asyncio.ensure_future(going)
            try:
                return await self._playing
            except MotionLostError as error:
                _LOG.warning("connection to the motion process lost", test=order.run_id, error=str(error))
                if not await self._is_known(motion, order.run_id):
                    if await asyncio.to_thread(shown_commanded, self._store, self._live.run) is False:
                        raise MeasurementError(
                            say(
                                "motion_process_ended_before",
                                "{tag}: the motion process ended before it moved the valve: repeat the test",
                                tag=order.tag,
                            )
                        ) from error
                    raise
                rejoined = self._is_rejoined = True

    async def _is_known(self, motion: MotionLink, run_id: str) -> bool:
        """Whether the motion process has this motion. Raises MotionLostError where it cannot be asked."""
        try:
            await motion.connect(_BACK_S)
            return any(one.order.run_id == run_id for one in await motion.left())
        except MotionLostError:
            raise
        except ValveError as error:  # it has another service, or is of another version: nothing is known of the valve
            raise MotionLostError(message_of(error)) from error

    async def _tell_stop(self, motion: MotionLink) -> None:
        await self._live.stop.wait()
        motion.stop(self._live.run.id, self._live.stop_reason)

    async def _tell_enough(self, motion: MotionLink, estimates: LiveEstimates) -> None:
        await estimates.enough.wait()
        motion.end_early(self._live.run.id, estimates.because)

    def _note(self, outcome: PlayOutcome) -> None:
        """Keep in memory how a motion left its valve, before anything is stored: it is not sent to safe once more."""
        self._commanded = self._commanded or outcome.commanded
        self._live.run = run = replace(self._live.run, commanded=self._commanded)
        if self._commanded:
            self._rest(outcome.safe_confirmed)  # from now on its stem has its time to come to rest
        self._tell_rest(confirmed=outcome.safe_confirmed, stands=outcome.stands)
        if not outcome.safe_confirmed:
            _LOG.error("safe state not confirmed", test=run.id, valve=run.valve, notes=list(outcome.notes))
        elif outcome.notes:
            _LOG.warning("motion ended with notes", test=run.id, valve=run.valve, notes=list(outcome.notes))

    async def _store_end(self, end: MotionEnd) -> None:
        outcome = end.outcome
        changes: dict[str, Any] = {"motion_ended_at": datetime.now(UTC), "safe_confirmed": outcome.safe_confirmed}
        changes["commanded"] = self._commanded
        if self._permissives is not None:
            changes["permissives"] = self._permissives
        if self._commanded:
            changes["stands"] = outcome.stands or self._rest(outcome.safe_confirmed).moving()
        if outcome.recording is not None:
            name, sha256 = await asyncio.to_thread(self._store.write_recording, self._live.run.id, outcome.recording)
            changes |= {"recording_file": name, "recording_sha256": sha256}
            changes["quality"] = await asyncio.to_thread(recording_quality, outcome.recording, outcome.notes)
        else:
            changes["quality"] = {"samples": 0, "notes": list(outcome.notes)}
        changes["quality"] |= {ENDED_KEY: outcome.ended.value, "writes": outcome.writes, **self._early(end)}
        error = "" if outcome.error is None else message_of(outcome.error)
        faults = [text for text in (*end.faults, error, end.stopped) if text]
        if not outcome.safe_confirmed:
            faults = [NOT_CONFIRMED, *faults, *([outcome.why_unsafe] if outcome.why_unsafe else [])]
        if outcome.ended is Ended.COMPLETED and not faults and outcome.recording is not None:
            await self._change(state=RunState.ANALYZING, progress=MOTION_SHARE, **changes)
        elif outcome.ended is Ended.STOPPED and not end.faults:
            await self._end(RunState.STOPPED, joined("; ", faults), **changes)
        else:
            faults = faults or [say("no_sample_taken", "no sample was taken")]
            await self._end(RunState.FAILED, joined("; ", faults), **changes)
        if outcome.recording is not None:
            # Not before the end is stored: until then the journal alone shows that the valve was commanded.
            try:
                await asyncio.to_thread(self._store.journal_path(self._live.run.id).unlink, missing_ok=True)
            except OSError as error:  # the next start removes it
                _LOG.warning("journal not removed", test=self._live.run.id, error=str(error))

    def _early(self, end: MotionEnd) -> dict[str, Any]:
        """Return what the test was to know, and where it ended early, why, and the time that was saved, s.

        The way back to the safe value from where it ended may be longer than from the sequence's end.
        """
        until, early_s = self._live.run.until, end.outcome.ended_early_s
        kept: dict[str, Any] = {} if until is None else {UNTIL_KEY: dict(until)}
        if early_s is not None and (until is not None or end.early is not None):
            waveform, limits = self._order.waveform, self._valve.wiring.limits
            safe_pa = self._rest(True).safe_pa or 0.0
            back_pa, usual_pa = (abs(float(waveform.at(at_s)) - safe_pa) for at_s in (early_s, waveform.duration_s))
            longer_s = (back_pa - usual_pa) / limits.pressure_rate_pa_per_s
            saved_s = max(0.0, waveform.duration_s - early_s - longer_s)
            early: dict[str, Any] = {"until": dict(until or {}), "saved_s": round(saved_s, 1)}
            if end.early is not None:  # whatever the test was to know, this ended it
                early |= {"until": {}, OUT_OF_FAMILY_KEY: dict(end.early)}
            kept[ENDED_EARLY_KEY] = early
        return kept

    async def _analyze(self, analyst: Analyst) -> None:
        run = self._live.run
        self._on_analysis(0.0, "analyzing")
        try:
            analysis = await assessed(
                analyst,
                run,
                self._valve,
                self._order.sequence,
                self._store,
                together=self._together,
                progress=self._on_analysis,
            )
        except ValveError as error:
            await self._end(RunState.FAILED, analysis_failed(message_of(error)))
        else:
            await self._end(RunState.COMPLETED, analysis=analysis, progress=1.0)

    # ---- what is heard of the motion

    def _on_armed(self, armed: Armed) -> None:
        self._entry_pa = armed.entry_pa
        run = self._live.run
        shown = Permission(armed.permissives, datetime.now(UTC), self._order.permit).to_json()
        of_service = [one for one in (run.permissives or {}).get("permissives", []) if one["name"] in _OF_SERVICE]
        shown["permissives"] += of_service  # disk and last end were read a moment ago; a device cannot know them
        self._permissives = shown
        self._storing_permissives = asyncio.create_task(self._change(permissives=shown))

    async def _permissives_stored(self) -> None:
        if self._storing_permissives is not None:
            await asyncio.wait({self._storing_permissives})
            if self._storing_permissives.exception() is not None:  # they are stored with the end
                _LOG.warning("permissives not stored yet", test=self._live.run.id)

    def _on_commanded(self) -> None:
        self._commanded = True

    def _on_samples(self, block: SampleBlock) -> None:
        self._live.samples(block)
        if self._estimates is not None:
            self._estimates.samples(block)
        self._on_kept(self._live.run.valve, block)

    def _on_progress(self, share: float, phase: str) -> None:
        if phase in (RETURNING, AT_SAFE, ENDED) and self._estimates is not None:
            self._estimates.end()
        if phase in (AT_SAFE, UPLOADING) and not self._live.at_rest.is_set():
            self._tell_rest(confirmed=True)
        if phase == UPLOADING:
            self._live.motion_ended.set()
        if phase == ENDED or self._live.stop.is_set():
            share = 0.0  # progress never falls: it stays where it was
        self._live.progress(MOTION_SHARE * share, phase)

    def _on_analysis(self, share: float, phase: str) -> None:
        self._live.progress(MOTION_SHARE + (1.0 - MOTION_SHARE) * share, phase)


def _nothing_moved(reason: str) -> str:
    return say("nothing_was_moved_as", "{why} (nothing was moved)", why=reason)


def _reason(error: Exception) -> str:
    cause = error.__cause__ if isinstance(error, ValveError) else error  # a file that could not be written
    told = cause.strerror if isinstance(cause, OSError) else None
    if isinstance(cause, OperationalError):
        told = str(cause.orig)
    if told:
        return say(
            "store_not_written",
            "the store cannot be written ({why}): look at its disk; what was sampled is stored at the next start",
            why=told,
        )
    if isinstance(error, ValveError) and not isinstance(error, InternalError):
        return message_of(error)
    return report_it(error)
