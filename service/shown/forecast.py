"""When a figure meets its limit, in words that are as round as the interval is wide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from typing import Any, Final

from service.model.health_figures import FIGURE_KINDS

_DAY_S: Final = 86400.0
_FARTHEST_DAYS: Final = 365.0  # what is further is no news to whoever plans the next stop
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
        return "limit" if self.name in _FRICTION else f"{self.words[0].lower()}{self.words[1:]}: limit"

    def soon(self, now: datetime) -> str:
        """Return how far ahead that is, such as ``in about 3 weeks``."""
        days = (self.at - now).total_seconds() / _DAY_S
        unit, size = next((unit, size) for unit, size, most in _UNITS if self._half_days(days) <= most)
        count = round(days / size)
        if count < 1:
            return f"in less than a {unit}" if days > 0.0 else "now"
        return f"in about {count} {unit}{'' if count == 1 else 's'}"

    def span(self, now: datetime, zone: tzinfo | None) -> str:
        """Return the interval by the plant's clock, such as ``12 December to 8 January 2027``; "" without, or past."""
        if self.earliest is None or (self.latest is not None and self.latest < now):
            return ""
        first = _day(max(self.earliest, now), now, zone, is_round=self._is_round)
        if self.latest is None:
            return f"not before {first}"
        last = _day(max(self.latest, now), now, zone, is_round=self._is_round)
        return first if first == last else f"{first} to {last}"

    def sentence(self, now: datetime, zone: tzinfo | None) -> str:
        """Return what a page says of it."""
        span = self.span(now, zone)
        return f"{self.words} meets its limit {self.soon(now)}{', ' if span else ''}{span}."

    def dates(self, zone: tzinfo | None) -> str:
        """Return what a report says of it, such as ``about 2026-12-26 (2026-12-12 to 2027-01-08)``."""
        form = "%Y-%m" if self._is_round else "%Y-%m-%d"
        at, *ends = (None if one is None else f"{one.astimezone(zone):{form}}" for one in self._instants)
        if ends[0] is None:
            return f"about {at}"
        return f"about {at} (not before {ends[0]})" if ends[1] is None else f"about {at} ({ends[0]} to {ends[1]})"

    @property
    def _instants(self) -> tuple[datetime, datetime | None, datetime | None]:
        return self.at, self.earliest, self.latest

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
    words = "friction" if name in _FRICTION else FIGURE_KINDS[name].words
    first, last = (None if one is None else datetime.fromisoformat(one) for one in ends)
    return Forecast(name, words[0].upper() + words[1:], datetime.fromisoformat(str(at)), first, last)


_KEYS: Final = ("reaches_limit_at", "reaches_limit_earliest", "reaches_limit_latest")


def _day(at: datetime, now: datetime, zone: tzinfo | None, *, is_round: bool) -> str:
    local = at.astimezone(zone)
    year = "" if local.year == now.astimezone(zone).year else f" {local.year}"
    return f"{local:%B}{year}" if is_round else f"{local.day} {local:%B}{year}"
