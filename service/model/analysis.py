"""An analysis as it is kept with its test: what is noted beside its figures, and whether one can be made again."""

from __future__ import annotations

from datetime import datetime, tzinfo
from typing import Final

from drivers.outcome import Ended
from service.model.requester import person_of
from service.model.run import ENDED_KEY, Run, RunState
from service.words.plant_clock import instant_words
from valve.messages import say

#: Raised by one whenever the same recording gives other figures: an analysis keeps it under ``engine``.
#: One without it is older than the first.
ENGINE: Final = 1
TOGETHER: Final = "together"  # key of an analysis that says which tests it is of
#: Key of an analysis that was made again: when, by which software and for whom.
REPEATED: Final = "repeated"
BEGUN_KEY: Final = "analysis_begun_again"  # of a run's quality while its analysis is under way: how often that began
#: How the reason of a test begins whose motion ended well.
ANALYSIS_FAILED: Final = say("analysis_failed", "the recording is stored, its analysis failed")
_MOST_BEGUN: Final = 3  # one that ends the service each time must not do so for ever


def analysis_failed(reason: str) -> str:
    """Return that only the analysis of a test failed, and why."""
    return say("analysis_failed_because", "{failed}: {why}", failed=ANALYSIS_FAILED, why=reason)


def can_be_analysed(run: Run) -> bool:
    """Whether a test that has ended has what an analysis needs: a whole recording, of a motion that ended well."""
    if run.recording_file is None or not run.state.finished:
        return False
    if run.state is RunState.COMPLETED:
        return True
    whole = run.safe_confirmed is True and (run.quality or {}).get(ENDED_KEY) == Ended.COMPLETED.value
    failed_afterwards = run.state is RunState.FAILED and run.error.startswith(ANALYSIS_FAILED)
    return whole and (failed_afterwards or run.state is RunState.INTERRUPTED)


def is_to_be_taken_up(run: Run, *, is_kept: bool) -> bool:
    """Whether only the analysis of an unfinished test of a dead process is missing; ``is_kept``: its recording is."""
    begun = int((run.quality or {}).get(BEGUN_KEY) or 0)
    whole = run.state is RunState.ANALYZING and run.safe_confirmed is True and run.recording_file is not None
    return whole and begun < _MOST_BEGUN and is_kept


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
