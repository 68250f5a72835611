"""Days in service in the database: the only module that turns their rows into days and back."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from datetime import date
from typing import Any, Final

from sqlalchemy import Engine, delete, insert, select

from service.model.health_figures import Figure
from service.model.watched_day import FrictionInService, JudgedBy, WatchedDay
from service.store.schema_watched import WATCHED_DAYS
from service.store.sentences import with_reason, with_sentences
from valve.messages import TABLE, with_table

_FRICTION: Final = ("friction_n", "friction_n_low", "friction_n_high")


class WatchedTable:
    """What days in service said, by valve; every method is one transaction and may block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def add(self, found: WatchedDay, gateway: str) -> None:
        """Store what a day said, in the place of what it said before."""
        friction = found.figure("friction")
        low, high = (None, None) if friction is None else friction.ci95 or (None, None)
        values = {
            "valve": found.valve,
            "day": found.day,
            "gateway": gateway,
            "began_at": found.began_at,
            "ended_at": found.ended_at,
            "rows": found.rows,
            "judged_at": found.judged_at,
            "software": found.software,
            "document": None if found.document is None else with_table(found.document),
            **with_reason(found.reason),
            "driven_by": found.driven_by,
            "travel_m": found.judged_by.travel_m,
            "area_m2": found.judged_by.area_m2,
            **dict(zip(_FRICTION, (None if friction is None else friction.value, low, high), strict=True)),
        }
        mine = (WATCHED_DAYS.c.valve == found.valve) & (WATCHED_DAYS.c.day == found.day)
        with self._engine.begin() as connection:
            connection.execute(delete(WATCHED_DAYS).where(mine))
            connection.execute(insert(WATCHED_DAYS).values(values))

    def newest(self, valve: str, limit: int) -> list[WatchedDay]:
        """Return the newest days of a valve, newest first."""
        query = select(WATCHED_DAYS).where(WATCHED_DAYS.c.valve == valve).order_by(WATCHED_DAYS.c.day.desc())
        with self._engine.connect() as connection:
            return [_day(row) for row in connection.execute(query.limit(limit))]

    def judged(self, valves: Collection[str], since: date) -> dict[str, set[date]]:
        """Return which days of these valves, ``since`` one, have been judged."""
        found: dict[str, set[date]] = {tag: set() for tag in valves}
        query = select(WATCHED_DAYS.c.valve, WATCHED_DAYS.c.day).where(WATCHED_DAYS.c.day >= since)
        with self._engine.connect() as connection:
            for row in connection.execute(query):
                if row.valve in found:
                    found[row.valve].add(row.day)
        return found

    def frictions(self, since: date) -> dict[str, list[FrictionInService]]:
        """Return the friction of each day since then that has one, by valve, oldest first."""
        names = ("valve", "day", "judged_at", "driven_by", "travel_m", "area_m2", *_FRICTION)
        columns = (WATCHED_DAYS.c[name] for name in names)
        wanted = (WATCHED_DAYS.c.day >= since) & WATCHED_DAYS.c.friction_n.is_not(None)
        found: defaultdict[str, list[FrictionInService]] = defaultdict(list)
        with self._engine.connect() as connection:
            for row in connection.execute(select(*columns).where(wanted).order_by(WATCHED_DAYS.c.day)):
                has_ends = row.friction_n_low is not None and row.friction_n_high is not None
                figure = Figure(row.friction_n, (row.friction_n_low, row.friction_n_high) if has_ends else None)
                by = JudgedBy(row.travel_m, row.area_m2)
                found[row.valve].append(FrictionInService(row.day, figure, row.judged_at, row.driven_by, by))
        return dict(found)


def _day(row: Any) -> WatchedDay:
    reason = with_sentences({"reason": row.reason, TABLE: row.messages})["reason"]
    return WatchedDay(
        row.valve,
        row.day,
        row.began_at,
        row.ended_at,
        row.rows,
        row.judged_at,
        row.software,
        None if row.document is None else with_sentences(row.document),
        reason,
        JudgedBy(row.travel_m, row.area_m2),
    )
