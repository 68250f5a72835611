"""When a valve's last result is too old to speak for it: by its days, or by the nights that gave none."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Final

from service.health.results import Ne107
from service.schedules.calendar import nth_last_due
from service.settings import Plant
from service.settings_nightly import Schedule

_KEPT: Final = timedelta(minutes=1)  # how long what the calendar said of a schedule is taken as the present
_DAY_S: Final = 86400.0


@dataclass(frozen=True, slots=True)
class Oldest:
    """The oldest result that still speaks for a valve, and in words why."""

    at: datetime
    allowed: str

    def is_stale(self, result_at: datetime | None) -> bool:
        """Whether a result of then is too old; there may be none at all."""
        return result_at is None or result_at < self.at

    def state(self, state: str | None, result_at: datetime | None) -> str | None:
        """Return a NE 107 state as it stands today: what was normal long ago is no longer known to be."""
        return Ne107.FUNCTION_CHECK.value if state == Ne107.NORMAL.value and self.is_stale(result_at) else state

    def health(
        self, health: Mapping[str, Any] | None, result_at: datetime | None, now: datetime
    ) -> Mapping[str, Any] | None:
        """Return health as it stands today, with a reason where it is too old."""
        if health is None or result_at is None or not self.is_stale(result_at):
            return health
        days = (now - result_at).total_seconds() / _DAY_S
        reason = f"The last result is {days:.3g} days old, {self.allowed}: test the valve."
        shown = self.state(health.get("ne107"), result_at)
        return {**health, "ne107": shown, "reasons": [*health.get("reasons", ()), reason]}


class Staleness:
    """The plant's rules: ``stale_days`` of each valve, and ``stale_checks`` of the schedules that it is in.

    Every gateway knows the whole plant's schedules, so a gateway that is dead is told by the others.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._schedules: defaultdict[str, list[Schedule]] = defaultdict(list)
        for schedule in plant.schedules:
            for tag in schedule.valves:
                self._schedules[tag].append(schedule)
        self._kept: dict[tuple[str, int], tuple[datetime, datetime | None]] = {}

    def oldest(self, tag: str, now: datetime) -> Oldest:
        """Return how old the last result of a valve of the plant may be."""
        limits = self._plant.valves[tag].health
        at, allowed = now - timedelta(days=limits.stale_days), f"{limits.stale_days:.3g} are allowed"
        for schedule in self._schedules.get(tag, ()):
            due_at = self._due(schedule, limits.stale_checks, now)
            if due_at is not None and due_at > at:
                at, allowed = due_at, f"older than the last {limits.stale_checks} times of schedule {schedule.name}"
        return Oldest(at, allowed)

    def _due(self, schedule: Schedule, count: int, now: datetime) -> datetime | None:
        asked_at, due_at = self._kept.get((schedule.name, count), (None, None))
        if asked_at is None or not asked_at <= now < asked_at + _KEPT:
            # A check may start as late as its window ends: until then it did not fail to come.
            due_at = nth_last_due(schedule, now - timedelta(seconds=schedule.window_s), count)
            self._kept[schedule.name, count] = (now, due_at)
        return due_at
