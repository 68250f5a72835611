"""When a figure meets its limit, in words that are as round as the interval is wide."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from typing import Any, Final

from service.model.health_figures import FIGURE_KINDS
from service.words.sentences import as_clause, as_heading, as_sentence, together
from valve.messages import Message, say

_DAY_S: Final = 86400.0
_FARTHEST_DAYS: Final = 365.0  # what is further is no news to whoever plans the next stop
_AHEAD: Final[dict[str, tuple[Message, Message, Callable[[int], Message]]]] = {
    "day": (
        say("in_less_than_day", "in less than a day"),
        say("in_about_day", "in about 1 day"),
        lambda n: say("in_about_days", "in about {n} days", n=n),
    ),
    "week": (
        say("in_less_than_week", "in less than a week"),
        say("in_about_week", "in about 1 week"),
        lambda n: say("in_about_weeks", "in about {n} weeks", n=n),
    ),
    "month": (
        say("in_less_than_month", "in less than a month"),
        say("in_about_month", "in about 1 month"),
        lambda n: say("in_about_months", "in about {n} months", n=n),
    ),
}
#: A unit with its days, and up to which half of the interval, days, it is the one to count in.
_UNITS: Final = (("day", 1.0, 4.0), ("week", 7.0, 30.0), ("month", 30.4, float("inf")))
_ROUND: Final = timedelta(days=90)  # an interval that is longer has its ends in months
_FRICTION: Final = ("friction_mean_n", "friction_coulomb_n", "friction_max_n")


@dataclass(frozen=True, slots=True)
class Forecast:
    """A figure's way to its limit: what people call it, when it is met, with the 95 % interval where it has ends."""

    name: str
    words: str
    at: datetime
    earliest: datetime | None
    latest: datetime | None

    @property
    def limit_words(self) -> str:
        """What a list calls the limit, beside friction."""
        if self.name in _FRICTION:
            return say("limit", "limit")
        return say("limit_of", "{words}: limit", words=as_clause(self.words))

    def soon(self, now: datetime) -> str:
        """Return how far ahead that is, such as ``in about 3 weeks``."""
        days = (self.at - now).total_seconds() / _DAY_S
        unit, size = next((unit, size) for unit, size, most in _UNITS if self._half_days(days) <= most)
        count = round(days / size)
        less, one, several = _AHEAD[unit]
        if count < 1:
            return less if days > 0.0 else say("now", "now")
        return one if count == 1 else several(count)

    def span(self, now: datetime, zone: tzinfo | None) -> str:
        """Return the interval by the plant's clock, such as ``12 December to 8 January 2027``; "" without, or past."""
        if self.earliest is None or (self.latest is not None and self.latest < now):
            return ""
        first = _day(max(self.earliest, now), now, zone, is_round=self._is_round)
        if self.latest is None:
            return say("not_before", "not before {first}", first=first)
        last = _day(max(self.latest, now), now, zone, is_round=self._is_round)
        return first if first == last else say("forecast_from_to", "{first} to {last}", first=first, last=last)

    def sentence(self, now: datetime, zone: tzinfo | None) -> str:
        """Return what a page says of it."""
        span = self.span(now, zone)
        met = say("meets_limit", "{figure} meets its limit {soon}", figure=self.words, soon=self.soon(now))
        return as_sentence(together([met, span], ", "))

    def dates(self, zone: tzinfo | None) -> str:
        """Return what a report says of it, such as ``about 2026-12-26 (2026-12-12 to 2027-01-08)``."""
        form = "%Y-%m" if self._is_round else "%Y-%m-%d"
        at = f"{self.at.astimezone(zone):{form}}"
        ends = [None if one is None else f"{one.astimezone(zone):{form}}" for one in (self.earliest, self.latest)]
        if ends[0] is None:
            return say("about_date", "about {at}", at=at)
        if ends[1] is None:
            return say("about_not_before", "about {at} (not before {first})", at=at, first=ends[0])
        return say("about_between", "about {at} ({first} to {last})", at=at, first=ends[0], last=ends[1])

    @property
    def _is_round(self) -> bool:
        """Whether the interval is so long that days in it would say too much."""
        return self.latest is None or self.earliest is None or self.latest - self.earliest > _ROUND

    def _half_days(self, days: float) -> float:
        if self.earliest is None or self.latest is None:
            return max(days, _UNITS[1][2])
        return 0.5 * (self.latest - self.earliest).total_seconds() / _DAY_S


def forecasts_of(health: Mapping[str, Any] | None, now: datetime) -> list[Forecast]:
    """Return the forecasts of a result that are nearer than a year, soonest first; of the frictions only one."""
    found = [one for one in all_forecasts(health) if (one.at - now).total_seconds() <= _FARTHEST_DAYS * _DAY_S]
    return sorted(found, key=lambda one: one.at)


def all_forecasts(health: Mapping[str, Any] | None) -> list[Forecast]:
    """Return the forecasts of a result, of the frictions only one; what is beyond its limit already has none."""
    beyond = {one["name"] for one in (health or {}).get("changes") or () if one.get("kept") is False}
    trends = {
        str(one["name"]): one
        for one in (health or {}).get("trends") or ()
        if one.get("reaches_limit_at") and one["name"] not in beyond
    }
    friction = None if beyond.intersection(_FRICTION) else next((name for name in _FRICTION if name in trends), None)
    return [_read(one) for name, one in trends.items() if name == friction or name not in _FRICTION]


def _read(trend: Mapping[str, Any]) -> Forecast:
    at, *ends = (trend.get(key) for key in _KEYS)  # results of earlier versions have no interval
    name = str(trend["name"])
    words = say("friction", "friction") if name in _FRICTION else FIGURE_KINDS[name].words
    first, last = (None if one is None else datetime.fromisoformat(one) for one in ends)
    return Forecast(name, as_heading(words), datetime.fromisoformat(str(at)), first, last)


_MONTHS: Final = (
    say("january", "January"),
    say("february", "February"),
    say("march", "March"),
    say("april", "April"),
    say("may", "May"),
    say("june", "June"),
    say("july", "July"),
    say("august", "August"),
    say("september", "September"),
    say("october", "October"),
    say("november", "November"),
    say("december", "December"),
)
_KEYS: Final = ("reaches_limit_at", "reaches_limit_earliest", "reaches_limit_latest")


def _day(at: datetime, now: datetime, zone: tzinfo | None, *, is_round: bool) -> Message:
    local = at.astimezone(zone)
    month = _MONTHS[local.month - 1]
    day = month if is_round else say("day_of_month", "{day} {month}", day=local.day, month=month)
    if local.year == now.astimezone(zone).year:
        return day
    return say("day_of_year", "{day} {year}", day=day, year=local.year)
