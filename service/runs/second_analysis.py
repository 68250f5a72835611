"""An analysis that the end of a service broke off, made again at its next start.

The motion had ended, its valve was read back at its safe value, and the whole recording is on disk: nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final

import structlog

from service.runs.analyst import Analyst
from service.runs.conclusion import Conclusion
from service.runs.live import LiveRun
from service.runs.run import Run, RunState
from service.runs.separating import SEPARATING, separating_of
from service.settings import Plant, PlantValve
from service.store.store import Store
from valve.errors import ValveError

_LOG = structlog.get_logger(__name__)
#: Key of a run's quality: how many analyses of it a service's end broke off.
BROKEN_OFF_KEY: Final = "analyses_broken_off"
_MOST_BROKEN_OFF: Final = 3  # a recording whose analysis takes the whole machine down must not do so for ever


@dataclass(frozen=True, slots=True)
class BrokenOff:
    """A run whose analysis alone is missing: the sequence that was played, and the tests it is analysed with."""

    run: Run
    valve: PlantValve
    sequence: str
    together: tuple[str, ...]


def broken_off(plant: Plant, store: Store, run: Run) -> BrokenOff | None:
    """Return what the analysis of an unfinished run of a dead process needs; None where more is missing. Blocks."""
    if run.state is not RunState.ANALYZING or run.safe_confirmed is not True or run.valve not in plant.valves:
        return None
    if run.recording_sha256 is None or not store.recording_path(run.id).exists():
        return None
    if _times(run) >= _MOST_BROKEN_OFF:
        return None
    sequence, together = run.sequence, tuple[str, ...]()
    if sequence == SEPARATING:
        try:
            wish = separating_of(store, run.valve)
        except ValveError:
            return None
        if store.runs.get(wish.tests[0]).number > run.number:  # a later test was completed: it wishes for another
            return None
        sequence, together = wish.sequence, wish.tests
    return BrokenOff(run, plant.valves[run.valve], sequence, together)


async def analyze_again(found: BrokenOff, live: LiveRun, store: Store, analyst: Analyst) -> None:
    """Analyse the recording of a run once more; an end that cannot be stored is left to the next start."""
    live.motion_ended.set()
    conclusion = Conclusion(live, store)
    times = _times(found.run) + 1
    _LOG.warning("analysis begun again", test=found.run.id, valve=found.run.valve, broken_off=times)
    try:
        await conclusion.change(quality={**(found.run.quality or {}), BROKEN_OFF_KEY: times})
        await conclusion.analyze(analyst, found.valve, found.sequence, found.together)
    except Exception as error:  # noqa: BLE001  - here a test's failure is stored
        _LOG.error("second analysis failed unexpectedly", test=found.run.id, exc_info=error)
        reason = f"the recording is stored, its analysis failed: {type(error).__name__}: {error}: report it"
        try:
            await conclusion.end(RunState.FAILED, reason)
        except Exception as unwritten:  # noqa: BLE001  - nobody may wait for ever; the next start finds it once more
            _LOG.error("end of test not stored", test=found.run.id, exc_info=unwritten)
            live.run = replace(live.run, state=RunState.FAILED, error=reason, finished_at=datetime.now(UTC))
            live.announce()


def _times(run: Run) -> int:
    return int((run.quality or {}).get(BROKEN_OFF_KEY, 0))
