"""Checks in the database: the only module that turns rows into checks and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

from sqlalchemy import Engine, Row, func, insert, select, update
from sqlalchemy.exc import IntegrityError

from service.model.check import Check, CheckState
from service.store.schema_nightly import SCHEDULE_RUNS
from service.store.sentences import with_reason, with_sentences
from valve.errors import NotFoundError
from valve.messages import say


def _check(row: Row[Any]) -> Check:
    values = with_sentences(dict(row._mapping))
    return Check(**(values | {"state": CheckState(values["state"])}))


class ScheduleRunTable:
    """Checks by id; every method is one transaction and may block, so callers on the event loop use a thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def insert(self, check: Check) -> Check | None:
        """Store a new check and return it with its id; None where this valve's check of this occurrence is there."""
        values = asdict(check) | {"state": check.state.value, **with_reason(check.reason)}
        values.pop("id")
        try:
            with self._engine.begin() as connection:
                key = connection.execute(insert(SCHEDULE_RUNS).values(values)).inserted_primary_key
        except IntegrityError:
            return None
        return None if key is None else self.get(key[0])

    def get(self, check_id: int) -> Check:
        """Return one check. Raises NotFoundError."""
        with self._engine.connect() as connection:
            row = connection.execute(select(SCHEDULE_RUNS).where(SCHEDULE_RUNS.c.id == check_id)).one_or_none()
        if row is None:
            raise NotFoundError(
                say(
                    "check_unknown",
                    "nightly check {check} is unknown: GET /schedules/night lists a night's",
                    check=check_id,
                )
            )
        return _check(row)

    def take_up(self, check_id: int, attempt: str, now: datetime) -> bool:
        """Mark a queued check as running by ``attempt``; False where it is queued no more: nobody starts it twice."""
        return self._change(check_id, CheckState.QUEUED, state="running", attempt=attempt, attempted_at=now)

    def put_back(self, check_id: int, attempt: str) -> bool:
        """Queue a check again that was taken up and whose test was not started."""
        table = SCHEDULE_RUNS.c
        with self._engine.begin() as connection:
            mine = (table.id == check_id) & (table.attempt == attempt) & table.test_id.is_(None)
            query = update(SCHEDULE_RUNS).where(mine, table.state == CheckState.RUNNING.value)
            return connection.execute(query.values(state="queued", attempt=None, attempted_at=None)).rowcount == 1

    def note_test(self, check_id: int, test_id: str) -> None:
        """Write down which test carries a running check out."""
        self._change(check_id, CheckState.RUNNING, test_id=test_id)

    def end(self, check_id: int, state: CheckState, reason: str, now: datetime) -> bool:
        """Write down how a check ended; False where it had ended already."""
        for former in (CheckState.RUNNING, CheckState.QUEUED):
            if self._change(check_id, former, state=state.value, ended_at=now, **with_reason(reason)):
                return True
        return False

    def _change(self, check_id: int, former: CheckState, **values: Any) -> bool:
        table = SCHEDULE_RUNS.c
        with self._engine.begin() as connection:
            query = update(SCHEDULE_RUNS).where(table.id == check_id, table.state == former.value).values(values)
            return connection.execute(query).rowcount == 1

    def in_states(self, gateway: str, states: Sequence[CheckState]) -> list[Check]:
        """Return one gateway's checks in these states, oldest first."""
        table = SCHEDULE_RUNS.c
        chosen = table.state.in_([state.value for state in states])
        query = select(SCHEDULE_RUNS).where(table.gateway == gateway, chosen).order_by(table.id)
        with self._engine.connect() as connection:
            return [_check(row) for row in connection.execute(query)]

    def unfinished_beside(self, check: Check) -> Check | None:
        """Return another check of the same valve, schedule and gateway that has not ended, if there is one."""
        table = SCHEDULE_RUNS.c
        unfinished = table.state.in_([CheckState.QUEUED.value, CheckState.RUNNING.value])
        same = (table.valve == check.valve) & (table.schedule == check.schedule) & (table.gateway == check.gateway)
        query = select(SCHEDULE_RUNS).where(same, unfinished, table.id != check.id).order_by(table.id).limit(1)
        with self._engine.connect() as connection:
            row = connection.execute(query).first()
        return None if row is None else _check(row)

    def between(self, start: datetime, end: datetime) -> list[Check]:
        """Return the checks that were due from ``start`` on and before ``end``, in the order of their turns."""
        table = SCHEDULE_RUNS.c
        query = select(SCHEDULE_RUNS).where(table.due_at >= start, table.due_at < end)
        with self._engine.connect() as connection:
            return [_check(row) for row in connection.execute(query.order_by(table.due_at, table.id))]

    def latest(self, schedule: str) -> list[Check]:
        """Return the checks of a schedule's newest occurrence."""
        table = SCHEDULE_RUNS.c
        newest = select(func.max(table.due_at)).where(table.schedule == schedule).scalar_subquery()
        query = select(SCHEDULE_RUNS).where(table.schedule == schedule, table.due_at == newest).order_by(table.id)
        with self._engine.connect() as connection:
            return [_check(row) for row in connection.execute(query)]

    def newest_due(self, schedule: str, gateway: str) -> datetime | None:
        """Return when the newest of a schedule's checks on this gateway was due; None where there was none."""
        table = SCHEDULE_RUNS.c
        query = select(table.due_at).where(table.schedule == schedule, table.gateway == gateway)
        with self._engine.connect() as connection:
            return connection.scalars(query.order_by(table.due_at.desc()).limit(1)).first()
