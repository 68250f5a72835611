"""Runs in the database: the only module that turns rows into runs and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Engine, Row, func, insert, select, update

from service.runs.run import Label, Run, RunState
from service.store.schema import TESTS
from valve.errors import NotFoundError


def _run(row: Row[Any]) -> Run:
    values = dict(row._mapping)
    values["state"] = RunState(values["state"])
    values["label"] = None if values["label"] is None else Label(values["label"])
    return Run(**values)


def _row(run: Run) -> dict[str, Any]:
    values = asdict(run)
    values["state"] = run.state.value
    values["label"] = None if run.label is None else run.label.value
    values.pop("number")
    return values


class RunTable:
    """Runs by id; every method is one transaction and may block, so callers on the event loop use a thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def insert(self, run: Run) -> Run:
        """Store a new run and return it with its number; it is on disk when this returns."""
        with self._engine.begin() as connection:
            number = connection.execute(insert(TESTS).values(_row(run))).inserted_primary_key
        if number is None:
            raise NotFoundError(f"test {run.id}: the database gave it no number")
        return self.get(run.id)

    def save(self, run: Run) -> None:
        """Write the whole run over its former state. Raises NotFoundError where it was never stored."""
        with self._engine.begin() as connection:
            changed = connection.execute(update(TESTS).where(TESTS.c.id == run.id).values(_row(run))).rowcount
        if changed != 1:
            raise NotFoundError(f"test {run.id} is unknown: it was never stored")

    def get(self, run_id: str) -> Run:
        """Return one run. Raises NotFoundError."""
        with self._engine.connect() as connection:
            row = connection.execute(select(TESTS).where(TESTS.c.id == run_id)).one_or_none()
        if row is None:
            raise NotFoundError(f"test {run_id} is unknown: GET /tests lists all")
        return _run(row)

    def by_idempotency_key(self, key: str) -> Run | None:
        """Return the run that was asked for with this key, if any."""
        with self._engine.connect() as connection:
            row = connection.execute(select(TESTS).where(TESTS.c.idempotency_key == key)).one_or_none()
        return None if row is None else _run(row)

    def newest(self, limit: int, *, before: int | None = None, valve: str | None = None) -> list[Run]:
        """Runs with a number below ``before``, newest first, at most ``limit``."""
        query = select(TESTS).order_by(TESTS.c.number.desc()).limit(limit)
        if before is not None:
            query = query.where(TESTS.c.number < before)
        if valve is not None:
            query = query.where(TESTS.c.valve == valve)
        with self._engine.connect() as connection:
            return [_run(row) for row in connection.execute(query)]

    def in_states(self, states: Sequence[RunState]) -> list[Run]:
        """Runs in one of these states, oldest first."""
        query = select(TESTS).where(TESTS.c.state.in_([state.value for state in states])).order_by(TESTS.c.number)
        with self._engine.connect() as connection:
            return [_run(row) for row in connection.execute(query)]

    def latest_by_valve(self, states: Sequence[RunState] = ()) -> dict[str, Run]:
        """Return the newest run of each valve, of those in ``states`` where any are given."""
        newest = select(func.max(TESTS.c.number)).group_by(TESTS.c.valve)
        if states:
            newest = newest.where(TESTS.c.state.in_([state.value for state in states]))
        with self._engine.connect() as connection:
            rows = connection.execute(select(TESTS).where(TESTS.c.number.in_(newest)))
            return {row.valve: _run(row) for row in rows}
