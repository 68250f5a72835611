"""The life of one run, from its intent on disk to its result on disk."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import structlog
from sqlalchemy.exc import OperationalError

from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.permissives import Permissive
from drivers.stands_at import StandsAt
from service.audit.log import AuditError, AuditLog
from service.buses.bus import BusOwners, Claim
from service.model.acknowledgement import ENDED_KEY
from service.model.run import RunState
from service.model.stands_words import NOT_CONFIRMED
from service.model.until import ENDED_EARLY_KEY, UNTIL_KEY
from service.runs.analyst import ANALYSIS_FAILED, Analyst, assessed
from service.runs.kept_samples import KeptSamples
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.live_estimates import LiveEstimates
from service.runs.permission import Permission
from service.runs.quality import recording_quality
from service.runs.rig import Order, Rig, Watcher
from service.runs.stem_looks import Rest, StemLooks
from service.store.store import Store
from valve.errors import InternalError, MeasurementError, ValveError

_LOG = structlog.get_logger(__name__)
_OF_SERVICE: Final = ("disk", "last_test")
# The phase in which a device's own samples are fetched: only then, and only where the valve was read back at safe.
UPLOADING: Final = "uploading"
RETURNING: Final = "returning"  # the sequence is over, and the valve on its way to its safe value
_NOTHING_MOVED: Final = " (nothing was moved)"
AT_SAFE: Final = "at its safe value"  # it was read back; the recording is still to be made
ENDED: Final = "ended"  # however it did: no sign of how much was done


OnSamples = Callable[[str, SampleBlock], None]  # a valve's tag and samples of it that were written down


class Life:
    """Carries one order out. The claim is given back as soon as the valve rests and its recording is on disk."""

    def __init__(
        self,
        live: LiveRun,
        order: Order,
        claim: Claim,
        store: Store,
        owners: BusOwners,
        *,
        looks: StemLooks,
        audit: AuditLog | None = None,
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
        self._order = order
        self._claim = claim
        self._store = store
        self._owners = owners
        self._kept: KeptSamples | None = None
        self._playing: asyncio.Future[PlayOutcome] | None = None
        self._disk_error = ""
        #: False where the end stands in memory alone, as the store could not be written.
        self.is_end_stored = True
        self._entry_pa: float | None = None
        self._commanded = False  # whether anything was sent that can move the valve
        self._audit = audit
        self._permissives: tuple[Permissive, ...] = ()

    async def run(self, rig: Rig, analyst: Analyst) -> None:
        """Move, record, analyse; every way it can end is stored in the run.

        A cancellation ends the motion, and its outcome and recording are stored all the same before it goes on.
        """
        try:
            if await self._to_its_end(self._moved(rig)):
                await self._analyze(analyst)
        except Exception as error:  # noqa: BLE001  - here a test's failure is stored
            await self._failed(rig, error)
        finally:
            if self._kept is not None:
                self._kept.close()
            if self._estimates is not None:
                self._estimates.end()
            self._live.at_rest.set()
            self._live.motion_ended.set()
            self._give_back()

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
        safe = self._order.valve.wiring.safe_value_pa
        safe_pa = self._entry_pa if isinstance(safe, str) else safe
        return Rest(
            self._live.run, self._order.valve, self._claim, self._at_rest_s, safe_pa, bool(confirmed), self._live
        )

    async def _to_its_end(self, motion: Coroutine[Any, Any, bool]) -> bool:
        """Wait for a motion and what is stored of it; a cancellation is handed to the motion, then to the caller."""
        task, cancelled = asyncio.ensure_future(motion), False
        while not task.done():
            try:
                await asyncio.shield(task)
            except asyncio.CancelledError:
                cancelled = True
                self._live.request_stop("stopped: the service ended")
                if self._playing is not None:
                    self._playing.cancel()
        if cancelled:
            raise asyncio.CancelledError
        return task.result()

    async def _moved(self, rig: Rig) -> bool:
        try:
            return await self._move(rig)
        except Exception as error:  # noqa: BLE001  - here a test's failure is stored
            await self._failed(rig, error)
        except asyncio.CancelledError:
            await self._rescue(rig, "the test was cancelled as the service ended")
        return False

    async def _failed(self, rig: Rig, error: Exception) -> None:
        _LOG.error("test failed unexpectedly", test=self._live.run.id, valve=self._live.run.valve, exc_info=error)
        await self._rescue(rig, "; ".join(text for text in (self._disk_error, _reason(error)) if text))

    def _tell_rest(self, *, confirmed: bool, stands: StandsAt | None = None) -> None:
        """Let whoever stopped the test hear that its valve was brought to rest, whatever the store does now."""
        self._live.run = replace(self._live.run, safe_confirmed=confirmed)
        if self._commanded:
            self._live.show_stands(stands or self._rest(confirmed).moving())
        self._live.at_rest.set()

    async def _rescue(self, rig: Rig, reason: str) -> None:
        """Store an end that was not foreseen; a valve that was commanded is sent to safe first, no other one is."""
        safe = self._live.run.safe_confirmed
        if self._commanded and safe is None:
            found = await rig.go_safe(self._order.valve, self._order.run_number, self._entry_pa)
            safe = found.confirmed
            reason += f"; {found.reason}" if found.reason else ""
        if not self._commanded:
            reason += _NOTHING_MOVED
        reasons = [NOT_CONFIRMED, reason] if safe is False else [reason]
        changes: dict[str, Any] = {"error": "; ".join(reasons), "finished_at": datetime.now(UTC)}
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

    async def _move(self, rig: Rig) -> bool:
        """Drive the valve and store what was recorded; True where there is something to analyse."""
        live = self._live
        if not live.stop.is_set():
            await self._change(state=RunState.RUNNING, started_at=datetime.now(UTC))
        if live.stop.is_set():
            await self._end(RunState.STOPPED, live.stop_reason, commanded=False)
            return False
        watcher = Watcher(
            self._on_ready,
            self._on_samples,
            self._on_progress,
            self._on_permissives,
            self._on_intent,
            self._on_commanded,
        )
        try:
            self._playing = asyncio.ensure_future(rig.play(self._order, watcher, live.stop))
            outcome = await self._playing
        except ValveError as error:
            if self._commanded:
                raise  # to the rescue: the valve may stand anywhere
            await self._end(RunState.FAILED, f"{error}{_NOTHING_MOVED}", commanded=False)
            return False
        self._note(outcome)
        if self._kept is not None:
            await self._kept.drained()
        await self._store_outcome(outcome)
        live.motion_ended.set()
        self._give_back()
        return live.run.state is RunState.ANALYZING

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

    async def _store_outcome(self, outcome: PlayOutcome) -> None:
        changes: dict[str, Any] = {"motion_ended_at": datetime.now(UTC), "safe_confirmed": outcome.safe_confirmed}
        changes["commanded"] = self._commanded
        if self._commanded:
            changes["stands"] = outcome.stands or self._rest(outcome.safe_confirmed).moving()
        if outcome.recording is not None:
            name, sha256 = await asyncio.to_thread(self._store.write_recording, self._live.run.id, outcome.recording)
            changes |= {"recording_file": name, "recording_sha256": sha256}
            changes["quality"] = await asyncio.to_thread(recording_quality, outcome.recording, outcome.notes)
        else:
            changes["quality"] = {"samples": 0, "notes": list(outcome.notes)}
        changes["quality"] |= {ENDED_KEY: outcome.ended.value, "writes": outcome.writes, **self._early(outcome)}
        unwritten = await self._end_in_audit(outcome)
        stopped = self._live.stop_reason if outcome.ended is Ended.STOPPED else ""
        faults = [text for text in (self._disk_error, unwritten, str(outcome.error or ""), stopped) if text]
        if not outcome.safe_confirmed:
            faults = [NOT_CONFIRMED, *faults, *([outcome.why_unsafe] if outcome.why_unsafe else [])]
        if outcome.ended is Ended.COMPLETED and not faults and outcome.recording is not None:
            await self._change(state=RunState.ANALYZING, progress=MOTION_SHARE, **changes)
        elif outcome.ended is Ended.STOPPED and not (self._disk_error or unwritten):
            await self._end(RunState.STOPPED, "; ".join(faults), **changes)
        else:
            await self._end(RunState.FAILED, "; ".join(faults) or "no sample was taken", **changes)
        if outcome.recording is not None and self._kept is not None:
            # Not before the end is stored: until then the journal alone shows that the valve was commanded.
            self._kept.close()
            try:
                await asyncio.to_thread(self._store.journal_path(self._live.run.id).unlink, missing_ok=True)
            except OSError as error:  # the next start removes it
                _LOG.warning("journal not removed", test=self._live.run.id, error=str(error))

    def _early(self, outcome: PlayOutcome) -> dict[str, Any]:
        """Return what the test was to know, and the time, s, that was saved where it knew that before its end.

        The way back to the safe value from where it ended may be longer than from the sequence's end.
        """
        until, early_s = self._live.run.until, outcome.ended_early_s
        if until is None:
            return {}
        kept: dict[str, Any] = {UNTIL_KEY: dict(until)}
        if early_s is not None:
            waveform, limits = self._order.waveform, self._order.valve.wiring.limits
            safe_pa = self._rest(True).safe_pa or 0.0
            back_pa, usual_pa = (abs(float(waveform.at(at_s)) - safe_pa) for at_s in (early_s, waveform.duration_s))
            longer_s = (back_pa - usual_pa) / limits.pressure_rate_pa_per_s
            saved_s = max(0.0, waveform.duration_s - early_s - longer_s)
            kept[ENDED_EARLY_KEY] = {"until": dict(until), "saved_s": round(saved_s, 1)}
        return kept

    async def _analyze(self, analyst: Analyst) -> None:
        run = self._live.run
        self._on_analysis(0.0, "analyzing")
        try:
            analysis = await assessed(
                analyst,
                run,
                self._order.valve,
                self._order.sequence,
                self._store,
                together=self._together,
                progress=self._on_analysis,
            )
        except ValveError as error:
            await self._end(RunState.FAILED, f"{ANALYSIS_FAILED}: {error}")
        else:
            await self._end(RunState.COMPLETED, analysis=analysis, progress=1.0)

    async def _on_ready(self, entry_pa: float, device: str) -> None:
        run = self._live.run
        self._entry_pa = entry_pa if math.isfinite(entry_pa) else None
        header = {
            "test": run.id,
            "valve": run.valve,
            "sequence": run.sequence,
            "run_number": run.number,
            "started_at": (run.started_at or run.created_at).isoformat(),
            "software": run.software,
            "device": device,
            "entry_pa": self._entry_pa,
        }
        self._kept = KeptSamples(self._store.journal_path(run.id), self._on_written, self._abort_for_disk)
        try:
            await self._kept.begin(header)
        except OSError as error:
            raise self._without_journal(error) from error
        shown = Permission(self._permissives, datetime.now(UTC), self._order.permit).to_json()
        details = {"sequence": run.sequence, "run_number": run.number, "device": device, "permissives": shown}
        await self._in_audit("motion.armed", {**details, "entry_pa": self._entry_pa, "permit": self._order.permit})
        of_service = [one for one in (run.permissives or {}).get("permissives", []) if one["name"] in _OF_SERVICE]
        shown["permissives"] += of_service  # disk and last end were read a moment ago; a device cannot know them
        await self._change(permissives=shown)

    async def _on_intent(self) -> None:
        """Write that the valve may move from now on; it is on disk when this returns."""
        assert self._kept is not None  # on_ready came before
        try:
            await self._kept.note_commanded()
        except OSError as error:
            raise self._without_journal(error) from error

    def _without_journal(self, error: OSError) -> MeasurementError:
        return MeasurementError(
            f"{self._live.run.valve}: the journal cannot be written ({error}), nothing moves without it: "
            "free some disk space"
        )

    def _on_commanded(self) -> None:
        self._commanded = True

    async def _in_audit(self, event: str, details: Mapping[str, Any]) -> None:
        """Write an event of this motion; it is on disk when this returns. Raises AuditError: then nothing may move."""
        run = self._live.run
        if self._audit is not None:
            append = partial(self._audit.append, event, valve=run.valve, test=run.id, details=details)
            await asyncio.to_thread(append, who=run.requested_by or "local")

    async def _end_in_audit(self, outcome: PlayOutcome) -> str:
        """Write how the motion ended; return why that could not be written."""
        details = {"ended": outcome.ended.value, "safe_confirmed": outcome.safe_confirmed, "writes": outcome.writes}
        early = {} if outcome.ended_early_s is None else {"ended_early_s": round(outcome.ended_early_s, 3)}
        reason = {} if outcome.error is None else {"error": str(outcome.error)}
        try:
            await self._in_audit("motion.ended", {**details, **early, **reason})
        except AuditError as error:
            return f"the end of the motion is not in the audit log: {error}"
        return ""

    def _on_permissives(self, permissives: tuple[Permissive, ...]) -> None:
        self._permissives = permissives

    def _on_samples(self, block: SampleBlock) -> None:
        # Nobody sees a sample that a crash could undo: first to the journal, then to the watchers.
        if self._kept is not None and not self._disk_error:
            self._kept.add(block)

    def _on_written(self, block: SampleBlock) -> None:
        if not self._disk_error:
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

    def _abort_for_disk(self, error: OSError) -> None:
        if not self._disk_error:
            _LOG.error("samples not written", test=self._live.run.id, valve=self._live.run.valve, error=str(error))
        self._disk_error = f"samples can no longer be written ({error.strerror or error}): the test was stopped"
        self._live.request_stop("")


def _reason(error: Exception) -> str:
    cause = error.__cause__ if isinstance(error, ValveError) else error  # a file that could not be written
    told = cause.strerror if isinstance(cause, OSError) else None
    if isinstance(cause, OperationalError):
        told = str(cause.orig)
    if told:
        return f"the store cannot be written ({told}): look at its disk; what was sampled is stored at the next start"
    if isinstance(error, ValveError) and not isinstance(error, InternalError):
        return str(error)
    return f"{type(error).__name__}: {error}: report it"
