"""An analysis without a motion before it: taken up after a restart, or repeated because somebody asks for it.

Nothing moves: what is read is the recording that was stored when the motion had come to its good end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, tzinfo
from typing import Any, Final

import structlog

from drivers.outcome import Ended
from service.config.plant import PlantValve
from service.model.acknowledgement import ENDED_KEY
from service.model.requester import person_of
from service.model.run import Run, RunState
from service.runs.analyst import ANALYSIS_FAILED, Analyst, analysis_failed, assessed
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.separating import played_by
from service.store.store import Store
from service.words.plant_clock import instant_words
from valve.errors import ValveError
from valve.messages import message_of, report_it, say

#: Key of an analysis that was made again: when, by which software and for whom.
REPEATED: Final = "repeated"
BEGUN_KEY: Final = "analysis_begun_again"  # of a run's quality while its analysis is under way: how often that began
_MOST_BEGUN: Final = 3  # one that ends the service each time must not do so for ever
_LOG = structlog.get_logger(__name__)


def can_be_analysed(run: Run) -> bool:
    """Whether a test that has ended has what an analysis needs: a whole recording, of a motion that ended well."""
    if run.recording_file is None or not run.state.finished:
        return False
    if run.state is RunState.COMPLETED:
        return True
    whole = run.safe_confirmed is True and (run.quality or {}).get(ENDED_KEY) == Ended.COMPLETED.value
    failed_afterwards = run.state is RunState.FAILED and run.error.startswith(ANALYSIS_FAILED)
    return whole and (failed_afterwards or run.state is RunState.INTERRUPTED)


def is_to_be_taken_up(run: Run, store: Store) -> bool:
    """Whether only the analysis of an unfinished test of a dead process is missing."""
    begun = int((run.quality or {}).get(BEGUN_KEY) or 0)
    whole = run.state is RunState.ANALYZING and run.safe_confirmed is True and run.recording_file is not None
    return whole and begun < _MOST_BEGUN and store.recording_path(run.id).is_file()


def words_of_repetition(run: Run, zone: tzinfo | None) -> str:
    """Return when, by the clock of ``zone``, and for whom a run was analysed again; "" where it was not."""
    about = (run.analysis or {}).get(REPEATED)
    if not about:
        return ""
    at = instant_words(datetime.fromisoformat(str(about["at"])), zone)
    person, software = person_of(str(about["by"])), str(about["software"])
    if not person:
        return say("made_again", "made again on {at} by {software}", at=at, software=software)
    return say("made_again_for", "made again on {at} for {who} by {software}", at=at, who=person, software=software)


def begun_again(run: Run) -> dict[str, Any]:
    """Return what changes in a run while its analysis is made again."""
    quality = dict(run.quality or {})
    quality[BEGUN_KEY] = int(quality.get(BEGUN_KEY) or 0) + 1
    changes = {"state": RunState.ANALYZING, "progress": MOTION_SHARE, "error": "", "finished_at": None}
    return {**changes, "quality": quality}


async def analyse_again(
    live: LiveRun, valve: PlantValve, store: Store, analyst: Analyst, *, about: Mapping[str, Any], behind: bool = False
) -> None:
    """Analyse the recording of a run that stands as ``begun_again`` says, and store how that ended.

    ``about`` is what the analysis says of its repetition; ``behind`` lets everything else go first. Where it fails a
    former result stands.
    """
    run = live.run
    quality = {key: value for key, value in (run.quality or {}).items() if key != BEGUN_KEY}

    def tell(share: float, phase: str) -> None:
        live.progress(MOTION_SHARE + (1.0 - MOTION_SHARE) * share, phase)

    tell(0.0, "analyzing")
    changes: dict[str, Any]
    try:
        sequence, together = await asyncio.to_thread(played_by, store, run)
        analysis = await assessed(analyst, run, valve, sequence, store, together=together, progress=tell, behind=behind)
        changes = {"state": RunState.COMPLETED, "analysis": {**analysis, REPEATED: dict(about)}, "progress": 1.0}
    except Exception as error:  # noqa: BLE001  - here an analysis' failure is stored
        _LOG.error("analysis failed", test=run.id, exc_info=None if isinstance(error, ValveError) else error)
        reason = message_of(error) if isinstance(error, ValveError) else report_it(error)
        changes = {"state": RunState.FAILED, "error": analysis_failed(reason)}
        if run.analysis is not None:
            failed = say(
                "repeating_analysis_failed",
                "repeating its analysis failed, the former result stands: {why}",
                why=reason,
            )
            changes = {"state": RunState.COMPLETED, "error": failed, "progress": 1.0}
    changes |= {"finished_at": datetime.now(UTC), "quality": quality}
    try:
        changed = await asyncio.to_thread(store.runs.change, run.id, changes)  # its stem was looked at meanwhile
    except Exception as error:  # noqa: BLE001  - it stands as unfinished in the store, and is taken up at the next start
        _LOG.error("analysis not stored", test=run.id, exc_info=error)
        reason = say("store_cannot_be_written", "the store cannot be written")
        changed = replace(run, state=RunState.FAILED, error=analysis_failed(reason))
    store.state_counts.count_anew()
    live.run = changed
    live.announce()
    _LOG.info("analysis ended", test=run.id, valve=run.valve, state=changed.state.value, error=changed.error)
