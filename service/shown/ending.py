"""A test without a result in words: what happened, where its motion left the valve, what to do.

The tablet's page and the report of such a test say the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, tzinfo
from functools import partial
from typing import Final

from drivers.outcome import Ended
from service.model.acknowledgement import ENDED_KEY, alarm_words, ended_badly, needs_acknowledgement
from service.model.requester import LOCAL, person_of
from service.model.run import Run, RunState
from service.model.stands_words import NOT_CONFIRMED, where_it_stands
from service.words.sentences import as_sentence

_Clock = Callable[[datetime | None], str]
_SENT_SAFE: Final = "; the valve was sent to its safe value"


@dataclass(frozen=True, slots=True)
class Ending:
    """How a test ended that has no result; texts are sentences in SI units, ``steps`` what to do, first things first.

    ``is_alarm``: its valve may stand otherwise than it should, or was moved until a fault ended it.
    """

    headline: str
    course: str
    why: str
    stands: str
    steps: tuple[str, ...]
    is_alarm: bool


def ending_of(
    run: Run, *, later: Run | None = None, moment: str = "%Y-%m-%d %H:%M:%S %Z", zone: tzinfo | None = None
) -> Ending:
    """Return how a finished test without a result ended.

    ``later`` is the newest test of the valve since, ``moment`` how times are written, by ``zone`` or else this
    machine's own.
    """
    assert run.state.finished
    assert run.analysis is None
    at = partial(_at, moment=moment, zone=zone)
    return Ending(
        _headline(run),
        _course(run, at),
        _why(run),
        _stands(run, later, at),
        tuple(_steps(run)),
        ended_badly(run),
    )


def _played_to_its_end(run: Run) -> bool:
    return (run.quality or {}).get(ENDED_KEY) == Ended.COMPLETED.value


def _nothing_moved(run: Run) -> bool:
    """Whether nothing was sent that can move the valve; not so where that was never kept."""
    return run.commanded is False


def _headline(run: Run) -> str:
    if _played_to_its_end(run):
        return f"{run.valve} was moved and recorded, but there is no result."
    tried = {RunState.FAILED: "failed", RunState.STOPPED: "was stopped"}.get(run.state, "was interrupted")
    return f"The test of {run.valve} {tried}{' before anything moved' if _nothing_moved(run) else ''}."


def _course(run: Run, at: _Clock) -> str:
    said = f"Asked for{_by(run.requested_by)} at {at(run.created_at)}"
    if run.started_at is None or _nothing_moved(run):
        return f"{said}; ended at {at(run.finished_at)}, nothing was moved."
    said += f"; begun at {at(run.started_at)}"
    if run.motion_ended_at is not None:
        lasted_s = (run.motion_ended_at - run.started_at).total_seconds()
        return f"{said}; the motion ended after {lasted_s:.0f} s."
    found = "found without its service" if run.state is RunState.INTERRUPTED else "ended"
    return f"{said}; {found} at {at(run.finished_at)}."


def _by(name: str) -> str:
    """Return who asked for a test; nothing where nobody signs in."""
    return f" by {person}" if (person := person_of(name)) else ""


def _why(run: Run) -> str:
    said = run.error.replace(f"stopped by {LOCAL.name}", "stopped by hand")
    for told_elsewhere in (f"{NOT_CONFIRMED}; ", f"; {NOT_CONFIRMED}", f"{run.valve}: ", _SENT_SAFE):
        said = said.replace(told_elsewhere, "")
    return as_sentence(said) or "Nobody said why."


def _stands(run: Run, later: Run | None, at: _Clock) -> str:
    said = where_it_stands(run)
    if later is not None:
        said += f" Since then it was asked for again, last at {at(later.created_at)} ({later.state.value})."
    return said


def _steps(run: Run) -> Iterator[str]:
    if alarm_words(run) and run.acknowledged_at is None:
        yield "Go and look at the valve now; bring it to a safe position by hand where it is not there."
    if needs_acknowledgement(run):
        yield (
            f"Look at the valve, then say what you found on its page, or by "
            f'breakaway acknowledge {run.valve} --note "...": until then no test of it starts.'
        )
    if _played_to_its_end(run):
        yield "The recording is kept: analyse it again on the page of the test, or repeat the test."
    elif run.state is RunState.STOPPED:
        yield "Start the test again when the valve may move."
    elif run.state is RunState.INTERRUPTED:
        yield "Look in the service's log why it ended. Nothing starts again by itself: start the test again."
    else:
        yield "Remove the reason that stands above, then start the test again."


def _at(at: datetime | None, moment: str, zone: tzinfo | None) -> str:
    return "an unknown time" if at is None else format(at.astimezone(zone), moment)
