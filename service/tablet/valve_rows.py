"""The list of valves, worst first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final

from service.parts import Parts
from service.runs.run import Run
from service.stands_words import NOT_CONFIRMED, where_it_stands
from service.store.conditions import valve_standings
from service.store.run_table import ValveHead
from service.tablet.words import STATES, Condition, condition_of

_ARROWS: Final = {"up": ("▲", "rising"), "down": ("▼", "falling"), "steady": ("▬", "steady"), "": ("", "")}


@dataclass(frozen=True, slots=True)
class ValveRow:
    """One valve in the list."""

    tag: str
    condition: Condition
    reason: str
    stands: str
    last_at: datetime | None
    last_words: str
    busy_with: str | None
    friction_n: float | None
    arrow: str
    trend: str
    next_check: datetime | None


def valve_conditions(parts: Parts) -> dict[str, Condition]:
    """Return how each valve stands, worst first, then by tag; reads the database, so callers use a thread."""
    standings = valve_standings(parts.store.engine)
    doubtful = [tag for tag, one in standings.items() if one.may_be_bad and tag in parts.plant.valves]
    heads = parts.store.runs.valve_heads(doubtful) if doubtful else {}
    conditions, now = {}, datetime.now(UTC)
    for tag in parts.plant.valves:
        standing = standings.get(tag)
        ne107 = None
        if standing is not None:
            ne107 = parts.staleness.oldest(tag, now).state(standing.ne107, standing.completed_at)
        is_busy = parts.runs.user_of(tag) is not None
        last = heads[tag].last if tag in heads else None
        conditions[tag] = condition_of(last, ne107, is_busy=is_busy, is_tested=standing is not None)
    return dict(sorted(conditions.items(), key=lambda item: (item[1].rank, item[0])))


def valve_rows(parts: Parts, tags: Sequence[str], due: Mapping[str, datetime]) -> list[ValveRow]:
    """Return a row a valve, in this order; reads the database, so callers use a thread."""
    heads = parts.store.runs.valve_heads(tags)
    rows = [_row(parts, tag, heads.get(tag), due.get(tag)) for tag in tags]
    completed = {tag: head.completed_number for tag, head in heads.items() if head.completed_number is not None}
    asked = [completed[row.tag] for row in rows if row.friction_n is None and row.tag in completed]
    measured_n = parts.store.figures.friction_mean_n(asked) if asked else {}
    return [
        row if row.friction_n is not None else replace(row, friction_n=measured_n.get(completed.get(row.tag, 0)))
        for row in rows
    ]


def _row(parts: Parts, tag: str, head: ValveHead | None, due: datetime | None) -> ValveRow:
    last = None if head is None else parts.runs.as_it_stands(head.last)
    now = datetime.now(UTC)
    oldest = parts.staleness.oldest(tag, now)
    health = {} if head is None else oldest.health(head.health, head.completed_at, now) or {}
    busy_with = parts.runs.user_of(tag)
    condition = condition_of(last, health.get("ne107"), is_busy=busy_with is not None, is_tested=last is not None)
    friction = _friction_change(health)
    arrow, trend = _ARROWS[friction_trend(friction)]
    return ValveRow(
        tag,
        condition,
        _reason(condition, last, health),
        "" if last is None else where_it_stands(last),
        None if last is None else last.created_at,
        "" if last is None else STATES[last.state],
        busy_with,
        None if friction is None else friction.get("now"),
        arrow,
        trend,
        due,
    )


def _reason(condition: Condition, last: Run | None, health: Mapping[str, Any]) -> str:
    """Return one sentence on why the valve stands as it does; empty where there is nothing to say."""
    if condition.code in ("alarm", "bad") and last is not None:
        return last.error.replace(f"{NOT_CONFIRMED}; ", "")
    if condition.code in ("F", "S", "C", "M") and condition.code == health.get("ne107"):  # under test is C, too
        return str(next(iter(health.get("reasons") or ()), ""))
    return ""


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
