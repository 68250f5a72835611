"""After a crash: what was cut off is marked, its samples are kept, its valve goes to safe; nothing resumes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import structlog

from service.audit.log import AuditLog
from service.runs.acknowledgement import NOT_CONFIRMED
from service.runs.gate import Gate
from service.runs.rig import Rig
from service.runs.run import Run, RunState, checked_run_id
from service.runs.tasks import Tasks
from service.settings import Plant
from service.store.journal import read_header, read_journal, recording_from_journal
from service.store.store import Store
from valve.errors import InternalError, RecordingError, ValveError

_LOG = structlog.get_logger(__name__)
_UNFINISHED: Final = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)


def _entry_pressure_pa(store: Store, run: Run) -> float | None:
    """Return what the device commanded before the test, Pa; None where its journal does not say it. Blocks."""
    try:
        entry_pa = read_header(store.journal_path(run.id)).get("entry_pa")
    except FileNotFoundError:
        return None
    except (OSError, ValveError) as error:
        _LOG.warning("entry value not read", test=run.id, error=str(error))
        return None
    return None if entry_pa is None else float(entry_pa)


def mark_interrupted(store: Store, run: Run) -> Run:
    """Turn an unfinished run of a dead process into an interrupted one; its journal becomes its recording. Blocks."""
    changes: dict[str, Any] = {"state": RunState.INTERRUPTED, "finished_at": datetime.now(UTC)}
    reason = "the service ended while this test was under way"
    if run.state is RunState.ANALYZING:
        reason += "; the recording is complete: analyse it by breakaway analyze"
    kept = False
    try:
        if store.journal_path(run.id).exists():
            changes |= _kept_journal(store, run)
    except (OSError, ValveError) as error:
        kept = True
        reason += f"; its journal is kept as no recording could be made of it: {error}"
    interrupted = replace(run, error=reason, **changes)
    store.runs.save(interrupted)
    if not kept:
        store.journal_path(run.id).unlink(missing_ok=True)
    _LOG.warning("test was interrupted", test=run.id, valve=run.valve, was=run.state.value)
    return interrupted


def _kept_journal(store: Store, run: Run) -> dict[str, Any]:
    """Turn a run's journal into its recording, where it has none; return what that changes in the run."""
    changes: dict[str, Any] = {}
    journal = store.journal_path(run.id)
    if run.recording_file is not None:
        return changes
    recording = recording_from_journal(journal)
    if recording is not None:
        changes["recording_file"], changes["recording_sha256"] = store.write_recording(run.id, recording)
    elif (samples := len(read_journal(journal)[1])) > 0:
        # Somebody may have seen them: what was shown is never thrown away.
        raise RecordingError(f"its samples ({samples}) are too few for one")
    return changes


def keep_journals_of_ended_runs(store: Store) -> None:
    """Turn journals of runs that ended without a recording (a full disk) into recordings. Blocks."""
    for journal in sorted((store.folder / "journals").glob("*.journal")):
        try:
            run = store.runs.get(checked_run_id(journal.stem))
            if run.state.finished:
                store.runs.save(replace(run, **_kept_journal(store, run)))
                journal.unlink()
        except (OSError, ValveError) as error:
            _LOG.warning("journal left as it is", journal=journal.name, error=str(error))


def _needs_safe(run: Run) -> bool:
    """Whether the valve of an unfinished run may stand somewhere else than at its safe value."""
    return run.safe_confirmed is not True


class Recovery:
    """Brings what a dead process left behind to rest; its tasks go on among ``tasks``."""

    def __init__(
        self, plant: Plant, store: Store, rig: Rig, gate: Gate, tasks: Tasks, *, audit: AuditLog | None = None
    ) -> None:
        self._plant = plant
        self._store = store
        self._rig = rig
        self._gate = gate
        self._tasks = tasks
        self._audit = audit

    async def begin(self) -> None:
        """Send the valves that a dead process left to safe, each in a task of its own, and mark its tests.

        The valves come first: neither a long journal nor a full disk holds them up.
        """
        unfinished = await asyncio.to_thread(
            self._store.runs.in_states, _UNFINISHED, gateway=self._plant.service.gateway
        )
        sent: dict[str, asyncio.Task[bool]] = {}
        for run in unfinished:
            if run.valve in self._plant.valves and _needs_safe(run):
                entry_pa = await asyncio.to_thread(_entry_pressure_pa, self._store, run)
                sent[run.id] = self._tasks.spawn(self._send_safe(run, entry_pa))
        marked = [await asyncio.to_thread(mark_interrupted, self._store, run) for run in unfinished]
        await asyncio.to_thread(keep_journals_of_ended_runs, self._store)
        for run in marked:
            if run.id in sent:
                self._tasks.spawn(self._note_safe(run.id, sent[run.id]))
            elif _needs_safe(run):
                error = f"{run.error}; {NOT_CONFIRMED}: plant.toml no longer names it"
                await asyncio.to_thread(self._store.runs.save, replace(run, error=error, safe_confirmed=False))

    async def _send_safe(self, run: Run, entry_pa: float | None) -> bool:
        valve = self._plant.valves[run.valve]
        claim = await self._gate.claim_when_free(run, valve)
        await self._note_in_audit("motion.recovery", run, {"run_number": run.number, "entry_pa": entry_pa})
        try:
            return await self._rig.go_safe(valve, run.number, entry_pa)
        except Exception as error:  # noqa: BLE001  - whatever it is, the result must say that the valve was not seen safe
            _LOG.error("valve not sent to safe", test=run.id, valve=run.valve, exc_info=error)
            return False
        finally:
            self._gate.owners.release(claim)

    async def _note_in_audit(self, event: str, run: Run, details: Mapping[str, Any]) -> None:
        """Write what is done for safety's sake; where that cannot be written it is done all the same."""
        if self._audit is None:
            return
        try:
            await asyncio.to_thread(
                partial(self._audit.append, event, who="service", valve=run.valve, test=run.id, details=details)
            )
        except InternalError as error:
            _LOG.error("not in the audit log", test=run.id, audit_event=event, error=str(error))

    async def _note_safe(self, run_id: str, sent: asyncio.Task[bool]) -> None:
        confirmed = await sent
        run = await asyncio.to_thread(self._store.runs.get, run_id)
        await self._note_in_audit("motion.ended", run, {"safe_confirmed": confirmed})
        run = await asyncio.to_thread(self._store.runs.get, run_id)  # as an acknowledgement left it meanwhile
        error = run.error + ("; the valve was sent to its safe value" if confirmed else f"; {NOT_CONFIRMED}")
        await asyncio.to_thread(self._store.runs.save, replace(run, safe_confirmed=confirmed, error=error))
        _LOG.warning("valve sent to safe", test=run.id, valve=run.valve, confirmed=confirmed)
