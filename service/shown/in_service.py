"""A valve's last day in service as its page shows it: watched, and told apart from what was tested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from drivers.watch_rules import WatchRules
from service.model.health_figures import Figure
from service.model.watched_day import WatchedDay
from valve.messages import say

_FIGURES: Final = (
    ("friction", say("service_friction", "Friction in motion"), "N"),
    ("breakaway", say("service_breakaway", "Breakaway"), "N"),
    ("dead_band_percent", say("service_dead_band", "Dead band"), "percent"),
    ("spring_rate", say("service_spring_rate", "Spring rate"), "N/m"),
)


@dataclass(frozen=True, slots=True)
class InServiceRow:
    """One figure, SI; ``note`` says why it is not known."""

    name: str
    unit: str
    figure: Figure | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class InService:
    """What a page says of a valve's days in service; ``when`` is how it is read, ``day`` the last that was judged."""

    when: str
    day: WatchedDay | None
    rows: tuple[InServiceRow, ...] = ()
    moves: int = 0
    turns: int = 0
    travel_m: float | None = None


def in_service_of(rules: WatchRules | None, newest_first: Sequence[WatchedDay]) -> InService | None:
    """Return what is shown of days in service; None of a valve that is not watched and never was."""
    if rules is None and not newest_first:
        return None
    when = "" if rules is None else _when(rules)
    day = newest_first[0] if newest_first else None
    if day is None or day.document is None:
        return InService(when, day)
    found: dict[str, Any] = dict(day.document)
    known = found["figures"]
    rows = tuple(
        InServiceRow(words, unit, day.figure(name), known.get(name, {}).get("note", ""))
        for name, words, unit in _FIGURES
    )
    travel = found.get("travel") or {}
    in_m = travel.get("unit") == "m"
    return InService(
        when,
        day,
        rows,
        int(found.get("moves", 0)),
        int(travel.get("cycles", 0)),
        float(travel["total"]) if in_m else None,
    )


def _when(rules: WatchRules) -> str:
    if rules.begins is None or rules.ends is None:
        return say("watched_all_day", "all day, every {period:g} s", period=rules.period_s)
    return say(
        "watched_between",
        "from {begins} to {ends}, every {period:g} s",
        begins=f"{rules.begins:%H:%M}",
        ends=f"{rules.ends:%H:%M}",
        period=rules.period_s,
    )
