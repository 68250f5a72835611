"""What changed since yesterday noon: worse, not tested and why, better, tested for the first time, unchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from typing import Final
from zoneinfo import ZoneInfo

from service.health.earlier import EarlierResults
from service.health.staleness import Oldest
from service.shown.words import Change, Condition, condition_of
from service.store.conditions import not_carried_out
from service.tablet.valve_stands import Stand, ValveSource
from service.words.sentences import as_clause, without
from valve.messages import say

_NOON: Final = time(12)
_NOTES: Final = 4  # of the first screen; the chips lead to all
_NAMED: Final = 3  # valves of one note


@dataclass(frozen=True, slots=True)
class Note:
    """Why valves are worse or were not tested: the first few of them, and how many more."""

    tags: tuple[str, ...]
    more: int
    change: Change
    words: str


@dataclass(frozen=True, slots=True)
class Since:
    """The change of each valve since ``at``, and what there is to say of those that a crew looks at first."""

    at: datetime
    changes: Mapping[str, Change]
    notes: tuple[Note, ...]


def yesterday_noon(now: datetime, zone: ZoneInfo | None) -> datetime:
    """Return noon of the day before by the plant's clock: the night that a person means lies behind it."""
    day = now.astimezone(zone).date() - timedelta(days=1)
    noon = datetime.combine(day, _NOON, zone)
    return noon.astimezone(UTC)


def since_yesterday(source: ValveSource, earlier: EarlierResults, stands: Mapping[str, Stand], now: datetime) -> Since:
    """Return what changed since yesterday noon; reads the database, so callers use a thread."""
    at = yesterday_noon(now, source.plant.zone)
    engine, plant = source.store.engine, source.plant
    tested = [tag for tag, one in stands.items() if one.standing is not None and one.standing.last_at >= at]
    results = earlier.states(engine, plant, at, tested)

    def before_of(tag: str, stand: Stand) -> Condition | None:
        """A bad end that stands bars the next test: one that is older than ``at`` stood then as it does now."""
        standing = stand.standing
        if standing is None or (tag not in results and stand.at_rest.code in ("alarm", "bad")):
            return stand.at_rest
        result = results.get(tag, (standing.ne107, standing.completed_at))
        if result is None:
            return None
        state = earlier.as_it_stood(plant, at, tag, result)
        result_at = result[1] or at
        state = Oldest(result_at, "").with_watched(source.staleness.watched(tag, at)).state(state, result_at)
        return condition_of(None, state, is_busy=False, is_tested=True)

    ended = not_carried_out(engine, at, now)
    missed = {tag: why for tag, due_at, why in ended if _is_open(stands, tag, due_at)}
    changes: dict[str, Change] = {}
    told: dict[tuple[Change, str], list[str]] = {}
    for tag, stand in stands.items():
        before = before_of(tag, stand)
        change = changes[tag] = _change(before, stand, is_missed=tag in missed)
        if change is Change.WORSE:
            was = say("was_not_known", "not known") if before is None else as_clause(before.words)
            words = say("was_and_is", "{was} → {now}", was=was, now=as_clause(stand.at_rest.words))
            told.setdefault((change, words), []).append(tag)
        elif change is Change.NOT_TESTED:
            told.setdefault((change, without(missed[tag], tag)), []).append(tag)
    return Since(at, changes, tuple(_notes(told)))


def _is_open(stands: Mapping[str, Stand], tag: str, due_at: datetime) -> bool:
    """Whether a valve's check that gave no result was not made good by a later test."""
    stand = stands.get(tag)
    if stand is None:
        return False
    completed_at = None if stand.standing is None else stand.standing.completed_at
    return completed_at is None or completed_at < due_at


def _change(before: Condition | None, stand: Stand, *, is_missed: bool) -> Change:
    now = stand.at_rest
    if before is not None and now.rank < before.rank:
        return Change.WORSE
    if before is None and now.code in ("alarm", "bad", "F"):
        return Change.WORSE
    if is_missed:
        return Change.NOT_TESTED
    if before is None:
        return Change.FIRST
    return Change.BETTER if now.rank > before.rank else Change.UNCHANGED


def _notes(told: Mapping[tuple[Change, str], list[str]]) -> Iterator[Note]:
    order = list(Change)
    ranked = sorted(told.items(), key=lambda item: order.index(item[0][0]))
    for (change, words), tags in ranked[:_NOTES]:
        yield Note(tuple(tags[:_NAMED]), max(0, len(tags) - _NAMED), change, words)
