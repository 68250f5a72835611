"""The list of valves, worst first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final

from service.config.plant import PlantValve
from service.model.run import Run
from service.model.stands_words import NOT_CONFIRMED, where_it_stands
from service.shown.forecast import forecasts_of
from service.shown.words import STATES, Condition, condition_of
from service.store.run_table import ValveHead
from service.tablet.valve_stands import ValveSource
from service.words.sentences import together, without
from valve.messages import say

_ARROWS: Final = {
    "up": ("▲", say("friction_rising", "rising")),
    "down": ("▼", say("friction_falling", "falling")),
    "steady": ("▬", say("friction_steady", "steady")),
    "": ("", ""),
}


@dataclass(frozen=True, slots=True)
class ValveRow:
    """One valve in the list."""

    tag: str
    about: str
    condition: Condition
    reason: str
    stands: str
    last_at: datetime | None
    last_words: str
    busy_with: str | None
    friction_n: float | None
    arrow: str
    trend: str
    forecast: str
    next_check: datetime | None


def valve_rows(source: ValveSource, tags: Sequence[str], due: Mapping[str, datetime]) -> list[ValveRow]:
    """Return a row a valve that the plant has, in this order; reads the database, so callers use a thread."""
    heads = source.store.runs.valve_heads(tags)
    # a reload may take valves meanwhile
    valves = dict(source.plant.valves)
    rows = [_row(source, tag, valves[tag], heads.get(tag), due.get(tag)) for tag in tags if tag in valves]
    completed = {tag: head.completed_number for tag, head in heads.items() if head.completed_number is not None}
    asked = [completed[row.tag] for row in rows if row.friction_n is None and row.tag in completed]
    measured_n = source.store.figures.friction_mean_n(asked) if asked else {}
    return [
        row if row.friction_n is not None else replace(row, friction_n=measured_n.get(completed.get(row.tag, 0)))
        for row in rows
    ]


def _row(source: ValveSource, tag: str, valve: PlantValve, head: ValveHead | None, due: datetime | None) -> ValveRow:
    last = None if head is None else source.runs.as_it_stands(head.last)
    identity, now = valve.identity, datetime.now(UTC)
    oldest = source.staleness.oldest(tag, now)
    tested = (None, None) if head is None else (head.health, head.completed_at)
    health = oldest.health(*tested, now) or {}
    busy_with = source.runs.user_of(tag)
    condition = condition_of(last, health.get("ne107"), is_busy=busy_with is not None, is_tested=last is not None)
    friction = _friction_change(health)
    arrow, trend = _ARROWS[friction_trend(friction)]
    return ValveRow(
        tag,
        " · ".join(one for one in (identity.description, identity.area) if one is not None),
        condition,
        _reason(condition, last, health),
        "" if last is None else where_it_stands(last),
        None if last is None else last.created_at,
        "" if last is None else STATES[last.state],
        busy_with,
        None if friction is None else friction.get("now"),
        arrow,
        trend,
        _forecast(health, now),
        due,
    )


def _reason(condition: Condition, last: Run | None, health: Mapping[str, Any]) -> str:
    """Return one sentence on why the valve stands as it does; empty where there is nothing to say."""
    if condition.code in ("alarm", "bad") and last is not None:
        return without(last.error, last.valve, NOT_CONFIRMED)
    if condition.code in ("F", "S", "C", "M") and condition.code == health.get("ne107"):  # under test is C, too
        return next(iter(health.get("reasons") or ()), "")
    return ""


def _forecast(health: Mapping[str, Any], now: datetime) -> str:
    """Return which limit is met next, in a few words; empty where none is within a year."""
    soonest = next(iter(forecasts_of(health, now)), None)
    if soonest is None:
        return ""
    return together([soonest.limit_words, soonest.soon(now)])


def _friction_change(health: Mapping[str, Any]) -> Mapping[str, Any] | None:
    changes = health.get("changes") or ()
    of_friction = [one for one in changes if str(one.get("name", "")).startswith("friction")]
    return next((one for one in of_friction if one.get("now") is not None), None)


def friction_trend(change: Mapping[str, Any] | None) -> str:
    """Return ``up``, ``down`` or ``steady`` by a comparison with the baseline; empty without one."""
    if change is None or change.get("change") is None:
        return ""
    ci95 = change.get("ci95")
    if change["change"] == 0.0 or (ci95 is not None and ci95[0] <= 0.0 <= ci95[1]):
        return "steady"
    return "up" if change["change"] > 0.0 else "down"
