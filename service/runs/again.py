"""An analysis without a motion before it: taken up after a restart, or repeated because somebody asks for it.

Nothing moves: what is read is the recording that was stored when the motion had come to its good end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import structlog

from service.config.plant import PlantValve
from service.model.analysis import BEGUN_KEY, REPEATED, analysis_failed
from service.model.run import Run, RunState
from service.runs.analyst import Analyst, assessed
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.separating import played_by
from service.store.store import Store
from valve.errors import ValveError
from valve.messages import message_of, report_it, say

_LOG = structlog.get_logger(__name__)


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
