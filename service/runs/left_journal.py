"""The journal of a test whose process died: what it still says of the motion, and its samples as a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import structlog

from drivers.motion.journal import read_header, read_journal, recording_from_journal, was_commanded
from service.model.run import Run, checked_run_id
from service.store.store import Store
from valve.errors import RecordingError, ValveError
from valve.messages import say

_LOG: Final = structlog.get_logger(__name__)


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


def shown_commanded(store: Store, run: Run) -> bool | None:
    """Whether an unfinished run commanded its valve, as the run or its journal shows; None where neither can. Blocks.

    Before anything is commanded it stands in the journal; from the end of the motion on it stands in the run.
    """
    if run.commanded is not None:
        return run.commanded
    try:
        return was_commanded(store.journal_path(run.id))
    except (OSError, ValveError) as error:
        _LOG.warning("journal does not say whether the valve was commanded", test=run.id, error=str(error))
        return None


def kept_as_recording(store: Store, run: Run) -> dict[str, Any]:
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
        raise RecordingError(say("samples_too_few", "its samples ({samples}) are too few for one", samples=samples))
    return changes


def keep_journals_of_ended_runs(store: Store) -> None:
    """Turn journals of runs that ended without a recording (a full disk) into recordings. Blocks."""
    for journal in sorted((store.folder / "journals").glob("*.journal")):
        try:
            run = store.runs.get(checked_run_id(journal.stem))
            if run.state.finished:
                store.runs.save(replace(run, **kept_as_recording(store, run)))
                journal.unlink()
        except (OSError, ValveError) as error:
            _LOG.warning("journal left as it is", journal=journal.name, error=str(error))
