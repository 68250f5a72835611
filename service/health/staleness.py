"""When a valve's last result is too old to speak for it: by its days, or by the nights that gave none."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from service.config.plant import Plant
from service.health.results import Ne107
from service.model.schedule import nth_last_due
from service.model.watched_day import ChangedInService
from valve.messages import say

_KEPT: Final = timedelta(minutes=1)  # how long an answer is taken as the present: limits are days
_DAY_S: Final = 86400.0
_ALWAYS: Final = datetime.max.replace(tzinfo=UTC)
_BELOW_MAINTENANCE: Final = (None, Ne107.FUNCTION_CHECK.value, Ne107.NORMAL.value)


@dataclass(frozen=True, slots=True)
class Oldest:
    """The oldest result that still speaks for a valve, and in words why."""

    at: datetime
    allowed: str
    watched: str = ""  # why the valve should be tested, as days in service say
    watched_since: datetime = _ALWAYS  # a test that came behind it has answered that

    def with_watched(self, said: ChangedInService | None) -> Oldest:
        """Return it with what days in service say against the valve."""
        return self if said is None else replace(self, watched=said.sentence, watched_since=said.since)

    def is_stale(self, result_at: datetime | None) -> bool:
        """Whether a result of then is too old; there may be none at all."""
        return result_at is None or result_at < self.at

    def state(self, state: str | None, result_at: datetime | None) -> str | None:
        """Return a NE 107 state as it stands today: what was normal long ago is no longer known to be.

        Where days in service say that the valve should be tested, it needs maintenance at least until it is.
        """
        if self._asks_for_test(result_at) and state in _BELOW_MAINTENANCE:
            return Ne107.MAINTENANCE.value
        return Ne107.FUNCTION_CHECK.value if state == Ne107.NORMAL.value and self.is_stale(result_at) else state

    def health(
        self, health: Mapping[str, Any] | None, result_at: datetime | None, now: datetime
    ) -> Mapping[str, Any] | None:
        """Return health as it stands today, with a reason where it is too old, and one that days in service give."""
        if self._asks_for_test(result_at):
            known = replace(self, watched="").health(health, result_at, now) or {}
            shown = self.state(known.get("ne107"), result_at)
            return {**known, "ne107": shown, "reasons": [self.watched, *known.get("reasons", ())], "watched": True}
        if health is None or result_at is None or not self.is_stale(result_at):
            return health
        days = (now - result_at).total_seconds() / _DAY_S
        reason = say(
            "result_too_old",
            "The last result is {days:.3g} days old, {allowed}: test the valve.",
            days=days,
            allowed=self.allowed,
        )
        shown = self.state(health.get("ne107"), result_at)
        return {**health, "ne107": shown, "reasons": [*health.get("reasons", ()), reason]}

    def _asks_for_test(self, result_at: datetime | None) -> bool:
        return bool(self.watched) and (result_at is None or result_at < self.watched_since)


@dataclass(frozen=True, slots=True)
class _Rule:
    """What valves of the same limits and schedules have in common."""

    days: float
    checks: int
    schedules: tuple[int, ...]


class Staleness:
    """The plant's rules: ``stale_days`` of each valve, and ``stale_checks`` of the schedules that it is in.

    Every gateway knows the whole plant's schedules, so a gateway that is dead is told by the others.
    """

    def __init__(self, plant: Plant) -> None:
        self._rules: dict[str, _Rule] = {}
        self._present: dict[_Rule, tuple[datetime, Oldest]] = {}
        self._watched: Mapping[str, ChangedInService] = {}
        self.read(plant)

    def note_watched(self, said: Mapping[str, ChangedInService]) -> None:
        """Note what days in service say against valves, by tag; of others they say nothing."""
        self._watched = dict(said)

    def watched(self, tag: str, at: datetime) -> ChangedInService | None:
        """Return what days in service said against a valve by then; None where that was nothing."""
        said = self._watched.get(tag)
        return said if said is not None and said.since <= at else None

    def read(self, plant: Plant) -> None:
        """Read the plant's rules anew; a valve that is gone keeps its own for whoever still lists it."""
        self._schedules = tuple(plant.schedules)
        places: defaultdict[str, list[int]] = defaultdict(list)
        for place, schedule in enumerate(self._schedules):
            for tag in schedule.valves:
                places[tag].append(place)
        limits = {tag: valve.health for tag, valve in plant.valves.items()}
        fresh = {
            tag: _Rule(one.stale_days, one.stale_checks, tuple(places.get(tag, ()))) for tag, one in limits.items()
        }
        gone = {tag: replace(rule, schedules=()) for tag, rule in self._rules.items() if tag not in fresh}
        self._rules, self._present = {**gone, **fresh}, {}

    def oldest(self, tag: str, now: datetime) -> Oldest:
        """Return how old the last result of a valve of the plant may be."""
        rule = self._rules[tag]
        known = self._present.get(rule)
        if known is None or not known[0] <= now < known[0] + _KEPT:
            known = self._present[rule] = (now, self._oldest(rule, now))
        return known[1].with_watched(self.watched(tag, now))

    def _oldest(self, rule: _Rule, now: datetime) -> Oldest:
        at = now - timedelta(days=rule.days)
        allowed = say("days_allowed", "{days:.3g} are allowed", days=rule.days)
        for schedule in (self._schedules[place] for place in rule.schedules):
            # A check may start as late as its window ends: until then it did not fail to come.
            due_at = nth_last_due(schedule, now - timedelta(seconds=schedule.window_s), rule.checks)
            if due_at is not None and due_at > at:
                at = due_at
                allowed = say(
                    "older_than_last_times",
                    "older than the last {n} times of schedule {schedule}",
                    n=rule.checks,
                    schedule=schedule.name,
                )
        return Oldest(at, allowed)
