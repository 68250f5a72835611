"""A test that ended badly: it stands as an alarm and bars the next test of its valve until somebody acknowledges it."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

from drivers.outcome import Ended
from drivers.permissive import Permissive
from drivers.stands_at import StemVerdict
from service.model.run import ENDED_KEY, Run, RunState
from service.model.stands_words import NOT_CONFIRMED, where_it_stands
from service.words.names import named
from valve.messages import Message, formed, joined, parts_of, say

#: What a stem that is not at its declared safe position is called; the sentence follows.
NOT_THERE: Final = say("stem_not_at_safe_position", "STEM NOT AT ITS SAFE POSITION: go and look at the valve")


def ended_badly(run: Run) -> bool:
    """Whether a valve may stand otherwise than it should, or was moved until a fault ended it.

    A test that was stopped, or whose analysis failed after a good motion, did not end badly; nor did one that never
    moved the valve. Where its stem was to be at a safe position and was not seen there, it did, whatever its result.
    """
    if stem_astray(run):
        return True
    if not run.state.finished:
        return False
    if run.safe_confirmed is False:
        return True
    how = (run.quality or {}).get(ENDED_KEY)
    if run.state is RunState.FAILED:
        return bool(run.commanded or run.safe_confirmed) and how != Ended.COMPLETED.value
    return (
        run.state is RunState.INTERRUPTED and run.commanded is not False and run.started_at is not None and how is None
    )


def stem_astray(run: Run) -> bool:
    """Whether the stem was not seen at the safe position that plant.toml declares."""
    return run.stands is not None and run.stands.verdict.is_alarm


def is_moving(run: Run) -> bool:
    """Whether the motion is over and the stem was not looked at yet."""
    return run.stands is not None and run.stands.verdict is StemVerdict.MOVING


def needs_acknowledgement(run: Run) -> bool:
    """Whether it ended badly and nobody has looked at it yet."""
    return ended_badly(run) and run.acknowledged_at is None


def alarm_of(run: Run | None) -> str:
    """Return the alarm that stands for a valve whose last test this is; "" where none does."""
    if run is None or not needs_acknowledgement(run):
        return ""
    alarm, stands, error = alarm_words(run), where_it_stands(run), beside_alarm(run.error)
    state = named(run.state.value)
    told = say("test_ended_so", "test {test} {state}", test=run.id, state=state)
    if error:
        told = say("test_ended_so_because", "test {test} {state}: {why}", test=run.id, state=state, why=error)
    if not alarm:
        return joined(". ", [told, *([_without_stop(stands)] if stands else [])])
    if stands.startswith(alarm):
        return say("alarm_in_where_it_stands", "{stands} ({test})", stands=stands, test=told)
    return say("alarm_and_where_it_stands", "{alarm}. {stands} ({test})", alarm=alarm, stands=stands, test=told)


def beside_alarm(error: str) -> str:
    """Return why a test has no result, without the alarm that stands beside it."""
    if not isinstance(error, Message):
        return error.replace(f"{NOT_CONFIRMED}; ", "")
    told = [part for part in parts_of(error) if part != NOT_CONFIRMED]
    return joined("; ", told) if told else error


def _without_stop(text: str) -> str:
    return text.formed("entry") if isinstance(text, Message) else formed(text, "entry")


def alarm_words(run: Run) -> str:
    """Return what is wrong with where a test left its valve, in capitals; "" where nothing is."""
    if run.safe_confirmed is False:
        return NOT_CONFIRMED
    return NOT_THERE if stem_astray(run) else ""


def acknowledged(run: Run, who: str, note: str) -> Run:
    """Return the run as somebody who looked at the valve leaves it; the first acknowledgement stays."""
    if run.acknowledged_at is not None:
        return run
    return replace(run, acknowledged_at=datetime.now(UTC), acknowledged_by=who, acknowledgement=note)


def last_end(run: Run | None) -> Permissive:
    """Return the permissive that the last test of a valve is."""
    name, limit = "last_test", say("ended_well_or_acknowledged", "one that ended well or was acknowledged")
    if run is None:
        return Permissive(name, True, say("no_test_yet", "none yet"), limit)
    if run.stands is not None and is_moving(run):
        wait = say("wait_for_look", "wait until it was looked at, {due:g s} after the motion", due=run.stands.due_s)
        return Permissive(name, False, say("stem_may_still_move", "the stem may still move"), limit, wait)
    state = named(run.state.value)
    if not needs_acknowledgement(run):
        if run.acknowledged_at is not None:
            state = say("ended_and_acknowledged", "{state}, acknowledged", state=state)
        return Permissive(name, True, state, limit)
    remedy = say(
        "acknowledge_first",
        "acknowledge first: look at the valve, then say so on its page, or by breakaway acknowledge {valve}",
        valve=run.valve,
    )
    if run.safe_confirmed is False:
        state = say("ended_not_confirmed", "{state}, SAFE STATE NOT CONFIRMED", state=state)
    elif stem_astray(run):
        state = say("ended_stem_astray", "{state}, STEM NOT AT ITS SAFE POSITION", state=state)
    return Permissive(name, False, state, limit, remedy)
