"""``[valves.watch]``: how a valve in service is read, by which clock, and how long its samples are kept."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Final
from zoneinfo import ZoneInfo

from valve.errors import ConfigurationError, refuse
from valve.messages import say

SHORTEST_PERIOD_S: Final = 0.02
LONGEST_PERIOD_S: Final = 10.0
MOST_DAYS: Final = 365


@dataclass(frozen=True, slots=True)
class WatchSpan:
    """One night, or one day, in which a valve is read; ``day`` is the date on which it begins, in the plant's zone."""

    day: date
    begins: datetime
    ends: datetime


@dataclass(frozen=True, slots=True)
class WatchRules:
    """Read every ``period_s``, from ``begins`` until ``ends`` by the clock of ``zone`` (None: this machine's).

    Without both times it is read all day. Samples are kept for ``keep_days``. Raises ConfigurationError where the
    rules contradict themselves.
    """

    period_s: float
    begins: time | None = None
    ends: time | None = None
    keep_days: int = 7
    zone: ZoneInfo | None = None

    def __post_init__(self) -> None:
        faults: list[str] = []
        if not (math.isfinite(self.period_s) and SHORTEST_PERIOD_S <= self.period_s <= LONGEST_PERIOD_S):
            faults.append(
                say(
                    "watch_period_outside",
                    "{key} is {period:g s}, it must be from {least:g in s} to {most:g s}: 0.1 s shows each slip of a "
                    "stem",
                    key="watch.period_s",
                    period=self.period_s,
                    least=SHORTEST_PERIOD_S,
                    most=LONGEST_PERIOD_S,
                )
            )
        if (self.begins is None) != (self.ends is None):
            faults.append(
                say(
                    "watch_times_incomplete",
                    "watch.from and watch.until belong together: give both, or neither for all day",
                )
            )
        if self.begins is not None and self.begins == self.ends:
            faults.append(
                say(
                    "watch_times_equal",
                    "watch.from and watch.until are both {time}: give two times, or neither for all day",
                    time=f"{self.begins:%H:%M}",
                )
            )
        if not 1 <= self.keep_days <= MOST_DAYS:
            faults.append(
                say(
                    "watch_days_outside",
                    "{key} is {days}, it must be from 1 to {most}: correct it",
                    key="watch.keep_days",
                    days=self.keep_days,
                    most=MOST_DAYS,
                )
            )
        refuse(ConfigurationError, faults)

    def span_of(self, day: date) -> WatchSpan:
        """Return the span that begins on a day."""
        begins, ends = self.begins or time.min, self.ends or time.min
        last = day if begins < ends else day + timedelta(days=1)
        return WatchSpan(day, self._instant(day, begins), self._instant(last, ends))

    def span_at(self, at: datetime) -> WatchSpan | None:
        """Return the span that an instant is in; None where the valve is not read then."""
        today = at.astimezone(self.zone).date()
        for day in (today, today - timedelta(days=1)):
            span = self.span_of(day)
            if span.begins <= at < span.ends:
                return span
        return None

    def _instant(self, day: date, clock: time) -> datetime:
        local = datetime.combine(day, clock)
        aware = local.astimezone() if self.zone is None else local.replace(tzinfo=self.zone)
        return aware.astimezone(UTC)
