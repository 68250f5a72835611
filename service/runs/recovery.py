"""After a crash: what was cut off is marked, its samples are kept, its valve goes to safe; nothing resumes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import structlog

from service.runs.run import Run, RunState, checked_run_id
from service.store.journal import read_journal, recording_from_journal
from service.store.store import Store
from valve.errors import NotFoundError, RecordingError

_LOG = structlog.get_logger(__name__)
UNFINISHED: Final = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)


def mark_interrupted(store: Store, run: Run) -> tuple[Run, float | None]:
    """Turn an unfinished run of a dead process into an interrupted one; its journal becomes its recording.

    Returns it with the pressure that the device commanded before the test, Pa, where the journal says it. Blocks.
    """
    changes: dict[str, Any] = {"state": RunState.INTERRUPTED, "finished_at": datetime.now(UTC)}
    reason = "the service ended while this test was under way"
    if run.state is RunState.ANALYZING:
        reason += "; the recording is complete: analyse it by breakaway analyze"
    entry_pa, kept = None, False
    try:
        if store.journal_path(run.id).exists():
            entry_pa = read_journal(store.journal_path(run.id))[0].get("entry_pa")
            changes |= _kept_journal(store, run)
    except RecordingError as error:
        kept = True
        reason += f"; its journal is kept as it cannot be read: {error}"
    interrupted = replace(run, error=reason, **changes)
    store.runs.save(interrupted)
    if not kept:
        store.journal_path(run.id).unlink(missing_ok=True)
    _LOG.warning("test was interrupted", test=run.id, valve=run.valve, was=run.state.value)
    return interrupted, entry_pa


def _kept_journal(store: Store, run: Run) -> dict[str, Any]:
    """Turn a run's journal into its recording, where it has none; return what that changes in the run."""
    changes: dict[str, Any] = {}
    journal = store.journal_path(run.id)
    if run.recording_file is None and (recording := recording_from_journal(journal)) is not None:
        changes["recording_file"], changes["recording_sha256"] = store.write_recording(run.id, recording)
    return changes


def keep_journals_of_ended_runs(store: Store) -> None:
    """Turn journals of runs that ended without a recording (a full disk) into recordings. Blocks."""
    for journal in sorted((store.folder / "journals").glob("*.journal")):
        try:
            run = store.runs.get(checked_run_id(journal.stem))
            if run.state.finished:
                store.runs.save(replace(run, **_kept_journal(store, run)))
                journal.unlink()
        except (NotFoundError, RecordingError) as error:
            _LOG.warning("journal left as it is", journal=journal.name, error=str(error))


def needs_safe(run: Run) -> bool:
    """Whether the valve of an unfinished run may stand somewhere else than at its safe value."""
    return run.safe_confirmed is not True
