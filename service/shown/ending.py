"""A test without a result in words: what happened, where its motion left the valve, what to do.

The tablet's page and the report of such a test say the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, tzinfo
from functools import partial
from typing import Any, Final

from drivers.outcome import Ended
from service.model.acknowledgement import alarm_words, ended_badly, needs_acknowledgement
from service.model.requester import LOCAL, person_of
from service.model.run import ENDED_KEY, Run, RunState
from service.model.stands_words import NOT_CONFIRMED, where_it_stands
from service.words.names import named
from service.words.sentences import as_sentence, together, without
from valve.messages import Message, changed, say

_Clock = Callable[[datetime | None], str]
_SENT_SAFE: Final = "; the valve was sent to its safe value"
_NOBODY_SAID: Final = say("nobody_said_why", "Nobody said why.")


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


def standing_at(run: Run | None) -> dict[str, Any]:
    """Return where a test left its valve, what is wrong with that, and what a page compares to see it change."""
    if run is None:
        return {"stands": "", "alarm": "", "verdict": ""}
    verdict = "" if run.stands is None else run.stands.verdict.value
    return {"stands": where_it_stands(run), "alarm": alarm_words(run), "verdict": verdict}


def _headline(run: Run) -> str:
    if _played_to_its_end(run):
        return say("moved_without_result", "{valve} was moved and recorded, but there is no result.", valve=run.valve)
    if run.state is RunState.FAILED:
        tried = say("test_failed", "The test of {valve} failed", valve=run.valve)
    elif run.state is RunState.STOPPED:
        tried = say("test_was_stopped", "The test of {valve} was stopped", valve=run.valve)
    else:
        tried = say("test_was_interrupted", "The test of {valve} was interrupted", valve=run.valve)
    return (
        say("before_motion", "{tried} before anything moved.", tried=tried)
        if _nothing_moved(run)
        else as_sentence(tried)
    )


def _course(run: Run, at: _Clock) -> str:
    person, asked_at, ended_at = person_of(run.requested_by), at(run.created_at), at(run.finished_at)
    asked = (
        say("asked_for_by", "Asked for by {person} at {asked_at}", person=person, asked_at=asked_at)
        if person
        else say("asked_for", "Asked for at {asked_at}", asked_at=asked_at)
    )
    if run.started_at is None or _nothing_moved(run):
        return say("ended_unmoved", "{asked}; ended at {ended_at}, nothing was moved.", asked=asked, ended_at=ended_at)
    begun = say("begun_at", "{asked}; begun at {begun_at}", asked=asked, begun_at=at(run.started_at))
    if run.motion_ended_at is not None:
        lasted_s = (run.motion_ended_at - run.started_at).total_seconds()
        return say("motion_lasted", "{begun}; the motion ended after {lasted:.0f} s.", begun=begun, lasted=lasted_s)
    if run.state is RunState.INTERRUPTED:
        return say("found_alone", "{begun}; found without its service at {at}.", begun=begun, at=ended_at)
    return say("course_ended_at", "{begun}; ended at {at}.", begun=begun, at=ended_at)


def _why(run: Run) -> str:
    if not isinstance(run.error, Message):  # kept before messages were data
        said = run.error.replace(f"stopped by {LOCAL.name}", "stopped by hand").replace(_SENT_SAFE, "")
        return as_sentence(without(said, run.valve, NOT_CONFIRMED)) or _NOBODY_SAID
    return as_sentence(changed(without(run.error, run.valve, NOT_CONFIRMED), _by_hand)) or _NOBODY_SAID


def _by_hand(text: str) -> str | None:
    """Nobody signs in where a stop has no name; that the valve was sent to its safe value follows."""
    if not isinstance(text, Message):
        return text
    if text.code == "stopped_by" and LOCAL.name in text.values.values():
        return say("stopped_by_hand", "stopped by hand")
    return None if text.code == "sent_to_safe" else text


def _stands(run: Run, later: Run | None, at: _Clock) -> str:
    said = where_it_stands(run)
    if later is None:
        return said
    since = say(
        "asked_for_again",
        "Since then it was asked for again, last at {at} ({state}).",
        at=at(later.created_at),
        state=named(later.state.value),
    )
    return together([said, since])


def _steps(run: Run) -> Iterator[str]:
    if alarm_words(run) and run.acknowledged_at is None:
        yield say(
            "go_and_look_now",
            "Go and look at the valve now; bring it to a safe position by hand where it is not there.",
        )
    if needs_acknowledgement(run):
        yield say(
            "look_and_acknowledge",
            "Look at the valve, then say what you found on its page, or by "
            'breakaway acknowledge {valve} --note "...": until then no test of it starts.',
            valve=run.valve,
        )
    if _played_to_its_end(run):
        yield say(
            "analyse_again", "The recording is kept: analyse it again on the page of the test, or repeat the test."
        )
    elif run.state is RunState.STOPPED:
        yield say("start_when_free", "Start the test again when the valve may move.")
    elif run.state is RunState.INTERRUPTED:
        yield say(
            "look_in_log",
            "Look in the service's log why it ended. Nothing starts again by itself: start the test again.",
        )
    else:
        yield say("remove_the_reason", "Remove the reason that stands above, then start the test again.")


def _at(at: datetime | None, moment: str, zone: tzinfo | None) -> str:
    return say("unknown_time", "an unknown time") if at is None else format(at.astimezone(zone), moment)
