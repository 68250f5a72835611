"""After a crash: what was cut off is marked, its samples are kept, its valve goes to safe; nothing resumes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import structlog

from service.runs.run import Run, RunState, checked_run_id
from service.store.journal import read_header, read_journal, recording_from_journal
from service.store.store import Store
from valve.errors import RecordingError, ValveError

_LOG = structlog.get_logger(__name__)
UNFINISHED: Final = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)


def entry_pressure_pa(store: Store, run: Run) -> float | None:
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


def needs_safe(run: Run) -> bool:
    """Whether the valve of an unfinished run may stand somewhere else than at its safe value."""
    return run.safe_confirmed is not True
