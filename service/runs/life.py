"""The life of one run, from its intent on disk to its result on disk."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import structlog
from sqlalchemy.exc import OperationalError

from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.permissives import Permissive
from service.audit.log import AuditError, AuditLog
from service.bus import BusOwners, Claim
from service.runs.acknowledgement import ENDED_KEY, NOT_CONFIRMED
from service.runs.analyst import Analyst, assessed
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.permission import Permission
from service.runs.quality import recording_quality
from service.runs.rig import Order, Rig, Watcher
from service.runs.run import RunState
from service.store.journal import JournalWriter
from service.store.store import Store
from valve.errors import MeasurementError, ValveError

_LOG = structlog.get_logger(__name__)
_SYNC_PERIOD_S: Final = 1.0
_OF_SERVICE: Final = ("disk", "last_test")
# The phase in which a device's own samples are fetched: only then, and only where the valve was read back at safe.
UPLOADING: Final = "uploading"
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
        audit: AuditLog | None = None,
        together: Sequence[str] = (),
        on_samples: OnSamples = lambda *_: None,
    ) -> None:
        self._on_kept = on_samples
        self._together = tuple(together)
        self._live = live
        self._order = order
        self._claim = claim
        self._store = store
        self._owners = owners
        self._journal: JournalWriter | None = None
        self._disk_error = ""
        #: False where the end stands in memory alone, as the store could not be written.
        self.is_end_stored = True
        self._entry_pa: float | None = None
        self._audit = audit
        self._permissives: tuple[Permissive, ...] = ()

    async def run(self, rig: Rig, analyst: Analyst) -> None:
        """Move, record, analyse; every way it can end is stored in the run."""
        try:
            moved_well = await self._move(rig)
            if moved_well:
                await self._analyze(analyst)
        except Exception as error:  # noqa: BLE001  - here a test's failure is stored
            _LOG.error("test failed unexpectedly", test=self._live.run.id, exc_info=error)
            await self._rescue(rig, "; ".join(text for text in (self._disk_error, _reason(error)) if text))
        finally:
            if self._journal is not None:
                self._journal.close()
            self._live.motion_ended.set()
            self._owners.release(self._claim)

    async def _rescue(self, rig: Rig, reason: str) -> None:
        """Store an end that was not foreseen; where the valve's state is unknown it is sent to safe first."""
        safe = self._live.run.safe_confirmed
        if safe is None and self._live.run.state is RunState.RUNNING:
            safe = await self._sent_safe(rig)
        reasons = [NOT_CONFIRMED, reason] if safe is False else [reason]
        changes: dict[str, Any] = {"error": "; ".join(reasons), "finished_at": datetime.now(UTC)}
        changes["safe_confirmed"] = safe
        try:
            await self._end(RunState.FAILED, **changes)
        except Exception as error:  # noqa: BLE001  - nobody may wait for ever for an end that cannot be stored
            _LOG.error("end of test not stored", test=self._live.run.id, exc_info=error)
            self.is_end_stored = False
            self._live.run = replace(self._live.run, state=RunState.FAILED, **changes)
            self._live.announce()

    async def _sent_safe(self, rig: Rig) -> bool:
        try:
            return await rig.go_safe(self._order.valve, self._order.run_number, self._entry_pa)
        except Exception as error:  # noqa: BLE001  - whatever it is, the valve was not seen safe
            _LOG.error("valve not sent to safe", test=self._live.run.id, exc_info=error)
            return False

    async def _change(self, **changes: Any) -> None:
        """Store the changed run, then let it be seen: nobody hears of what a crash could undo."""
        changed = replace(self._live.run, **changes)
        await asyncio.to_thread(self._store.runs.save, changed)
        self._live.run = changed
        self._live.announce()

    async def _end(self, state: RunState, error: str = "", **changes: Any) -> None:
        await self._change(**{"state": state, "error": error, "finished_at": datetime.now(UTC), **changes})
        _LOG.info("test ended", test=self._live.run.id, valve=self._live.run.valve, state=state.value, error=error)

    async def _move(self, rig: Rig) -> bool:
        """Drive the valve and store what was recorded; True where there is something to analyse."""
        live = self._live
        if live.stop.is_set():
            await self._end(RunState.STOPPED, live.stop_reason)
            return False
        await self._change(state=RunState.RUNNING, started_at=datetime.now(UTC))
        syncing = asyncio.create_task(self._sync_journal())
        watcher = Watcher(self._on_ready, self._on_samples, self._on_progress, self._on_permissives)
        try:
            outcome = await rig.play(self._order, watcher, live.stop)
        except ValveError as error:  # before anything moved: a motion ends in an outcome
            await self._end(RunState.FAILED, f"{error} (nothing was moved)")
            return False
        finally:
            syncing.cancel()
        await self._store_outcome(outcome)
        live.motion_ended.set()
        self._owners.release(self._claim)
        return live.run.state is RunState.ANALYZING

    async def _store_outcome(self, outcome: PlayOutcome) -> None:
        changes: dict[str, Any] = {"motion_ended_at": datetime.now(UTC), "safe_confirmed": outcome.safe_confirmed}
        if outcome.recording is not None:
            name, sha256 = await asyncio.to_thread(self._store.write_recording, self._live.run.id, outcome.recording)
            changes |= {"recording_file": name, "recording_sha256": sha256}
            changes["quality"] = await asyncio.to_thread(recording_quality, outcome.recording, outcome.notes)
        else:
            changes["quality"] = {"samples": 0, "notes": list(outcome.notes)}
        changes["quality"] |= {ENDED_KEY: outcome.ended.value, "writes": outcome.writes}
        if self._journal is not None:
            await asyncio.to_thread(self._put_journal_away, self._journal, outcome.recording is not None)
        unwritten = await self._end_in_audit(outcome)
        stopped = self._live.stop_reason if outcome.ended is Ended.STOPPED else ""
        faults = [text for text in (self._disk_error, unwritten, str(outcome.error or ""), stopped) if text]
        if not outcome.safe_confirmed:
            faults.insert(0, NOT_CONFIRMED)
        if outcome.ended is Ended.COMPLETED and not faults and outcome.recording is not None:
            await self._change(state=RunState.ANALYZING, progress=MOTION_SHARE, **changes)
        elif outcome.ended is Ended.STOPPED and not (self._disk_error or unwritten):
            await self._end(RunState.STOPPED, "; ".join(faults), **changes)
        else:
            await self._end(RunState.FAILED, "; ".join(faults) or "no sample was taken", **changes)

    def _put_journal_away(self, journal: JournalWriter, recorded: bool) -> None:
        journal.close()
        if recorded:
            self._store.journal_path(self._live.run.id).unlink(missing_ok=True)

    async def _analyze(self, analyst: Analyst) -> None:
        run = self._live.run
        self._on_analysis(0.0, "analyzing")
        try:
            analysis = await assessed(
                analyst, run, self._order, self._store, together=self._together, progress=self._on_analysis
            )
        except ValveError as error:
            await self._end(RunState.FAILED, f"the recording is stored, its analysis failed: {error}")
        else:
            await self._end(RunState.COMPLETED, analysis=analysis, progress=1.0)

    async def _sync_journal(self) -> None:
        while True:
            await asyncio.sleep(_SYNC_PERIOD_S)
            if self._journal is not None:
                try:
                    await asyncio.to_thread(self._journal.sync)
                except OSError as error:
                    self._abort_for_disk(error)
                    return

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
        try:
            self._journal = await asyncio.to_thread(JournalWriter, self._store.journal_path(run.id), header)
        except OSError as error:
            raise MeasurementError(
                f"{run.valve}: the journal cannot be written ({error}): nothing was moved"
            ) from error
        shown = Permission(self._permissives, datetime.now(UTC), self._order.permit).to_json()
        details = {"sequence": run.sequence, "run_number": run.number, "device": device, "permissives": shown}
        await self._in_audit("motion.armed", {**details, "entry_pa": self._entry_pa, "permit": self._order.permit})
        of_service = [one for one in (run.permissives or {}).get("permissives", []) if one["name"] in _OF_SERVICE]
        shown["permissives"] += of_service  # disk and last end were read a moment ago; a device cannot know them
        await self._change(permissives=shown)

    async def _in_audit(self, event: str, details: Mapping[str, Any]) -> None:
        """Write an event of this motion; it is on disk when this returns. Raises AuditError: then nothing may move."""
        run = self._live.run
        if self._audit is not None:
            append = partial(self._audit.append, event, valve=run.valve, test=run.id, details=details)
            await asyncio.to_thread(append, who=run.requested_by or "local")

    async def _end_in_audit(self, outcome: PlayOutcome) -> str:
        """Write how the motion ended; return why that could not be written."""
        details = {"ended": outcome.ended.value, "safe_confirmed": outcome.safe_confirmed, "writes": outcome.writes}
        reason = {} if outcome.error is None else {"error": str(outcome.error)}
        try:
            await self._in_audit("motion.ended", {**details, **reason})
        except AuditError as error:
            return f"the end of the motion is not in the audit log: {error}"
        return ""

    def _on_permissives(self, permissives: tuple[Permissive, ...]) -> None:
        self._permissives = permissives

    def _on_samples(self, block: SampleBlock) -> None:
        # Nobody sees a sample that a crash could undo: first to the journal, then to the watchers.
        if self._journal is not None and not self._disk_error:
            try:
                self._journal.append(block)
            except OSError as error:
                self._abort_for_disk(error)
        if not self._disk_error:
            self._live.samples(block)
            self._on_kept(self._live.run.valve, block)

    def _on_progress(self, share: float, phase: str) -> None:
        if phase == UPLOADING and not self._live.motion_ended.is_set():
            self._live.run = replace(self._live.run, safe_confirmed=True)
            self._live.motion_ended.set()
        if phase == ENDED or self._live.stop.is_set():
            share = 0.0  # progress never falls: it stays where it was
        self._live.progress(MOTION_SHARE * share, phase)

    def _on_analysis(self, share: float, phase: str) -> None:
        self._live.progress(MOTION_SHARE + (1.0 - MOTION_SHARE) * share, phase)

    def _abort_for_disk(self, error: OSError) -> None:
        self._disk_error = f"samples can no longer be written ({error.strerror or error}): the test was stopped"
        self._live.request_stop("")


def _reason(error: Exception) -> str:
    cause = error.__cause__ if isinstance(error, ValveError) else error  # a file that could not be written
    told = cause.strerror if isinstance(cause, OSError) else None
    if isinstance(cause, OperationalError):
        told = str(cause.orig)
    if told:
        return f"the store cannot be written ({told}): look at its disk; what was sampled is stored at the next start"
    return f"{type(error).__name__}: {error}: report it"
