"""Runs in the database: the only module that turns rows into runs and back."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Engine, Select, Table, delete, func, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from drivers.stands_at import StandsAt, StemVerdict
from service.model.run import Label, Run, RunState
from service.model.until import UNTIL_KEY
from service.store.figure_table import write_figures
from service.store.run_filter import RunFilter
from service.store.schema_nightly import VALVE_HEALTHS, VALVE_STATES
from service.store.schema_tests import ANALYSES, TESTS
from service.store.sentences import with_sentences
from valve.errors import NotFoundError
from valve.messages import TABLE, restored, say, with_table

#: Stands for the analysis of a run that came from a list: it is many times the rest.
NOT_LOADED: Final[Mapping[str, Any]] = MappingProxyType({"not_loaded": True})
_DOCUMENT: Final = "document"
_NAMES: Final = tuple(column.name for column in TESTS.c)


@dataclass(frozen=True, slots=True)
class ValveHead:
    """The last test of a valve, without its analysis, and the health that its last completed test found, and when."""

    last: Run
    completed_number: int | None
    completed_at: datetime | None
    health: Mapping[str, Any] | None


_ALL: Final = RunFilter()


def _whole() -> Select[Any]:
    return select(TESTS, ANALYSES.c.document).join_from(TESTS, ANALYSES, isouter=True)


def _head(row: Any) -> Run:
    """Return the run that a row begins with; by place, as lists have thousands of rows."""
    values = dict(zip(_NAMES, row, strict=False))
    values["analysis"] = NOT_LOADED
    return _as_run(values)


def _run(row: Any) -> Run:
    values = dict(row._mapping)
    document = values.pop(_DOCUMENT)
    return _as_run(values | {"analysis": None if document is None else restored(document)})


def _as_run(values: dict[str, Any]) -> Run:
    if values[TABLE]:
        values = restored(values)
    del values[TABLE]
    values["state"] = RunState(values["state"])
    values["label"] = None if values["label"] is None else Label(values["label"])
    values["stands"] = None if values["stands"] is None else StandsAt.from_json(values["stands"])
    values["until"] = (values["quality"] or {}).get(UNTIL_KEY)
    return Run(**values)


def _row(run: Run) -> dict[str, Any]:
    values = {name: getattr(run, name) for name in _NAMES if name not in ("number", TABLE)}
    values["state"] = run.state.value
    values["label"] = None if run.label is None else run.label.value
    for name in ("overrides", "quality", "permissives"):
        values[name] = None if values[name] is None else dict(values[name])
    values["stands"] = None if run.stands is None else run.stands.to_json()
    values[TABLE] = with_table(values).get(TABLE)
    return values


def _upsert(connection: Connection, table: Table) -> Any:
    return (postgresql.insert if connection.dialect.name == "postgresql" else sqlite.insert)(table)


def _write_analysis(connection: Connection, run: Run) -> None:
    mine = ANALYSES.c.number == run.number
    if run.analysis is None:
        connection.execute(delete(ANALYSES).where(mine))
        return
    document = {_DOCUMENT: with_table(run.analysis)}
    query = _upsert(connection, ANALYSES).values(number=run.number, **document)
    connection.execute(query.on_conflict_do_update(index_elements=[ANALYSES.c.number], set_=document))


def _note_state(connection: Connection, run: Run) -> None:
    """Keep the rows of the run's valve; an older test that is written again changes nothing of a newer one."""
    states = VALVE_STATES.c
    mine = states.valve == run.valve
    last = {
        "last_number": run.number,
        "state": run.state.value,
        "safe_confirmed": run.safe_confirmed,
        "stem": None if run.stands is None else run.stands.verdict.value,
        "last_at": run.created_at,
    }
    query = _upsert(connection, VALVE_STATES).values(last | {"valve": run.valve})
    connection.execute(query.on_conflict_do_nothing(index_elements=[states.valve]))
    connection.execute(update(VALVE_STATES).where(mine, states.last_number <= run.number).values(last))
    if run.state is not RunState.COMPLETED:
        return
    health = None if run.analysis is None else run.analysis.get("health")
    completed = {
        "completed_number": run.number,
        "completed_at": run.created_at,
        "ne107": None if health is None else health.get("ne107"),
        "effect_percent": None if health is None else health.get("effect_percent_of_span"),
    }
    newer = states.completed_number.is_(None) | (states.completed_number <= run.number)
    if connection.execute(update(VALVE_STATES).where(mine, newer).values(completed)).rowcount == 1:
        query = _upsert(connection, VALVE_HEALTHS).values(
            valve=run.valve, health=None if health is None else with_table(health)
        )
        whole = {"health": query.excluded.health}
        connection.execute(query.on_conflict_do_update(index_elements=[VALVE_HEALTHS.c.valve], set_=whole))


def _write_all(connection: Connection, run: Run) -> None:
    """Write what is kept of a run beside its own row, in the same transaction."""
    _write_analysis(connection, run)
    _note_state(connection, run)
    if run.state is RunState.COMPLETED and run.analysis is not None:
        write_figures(connection, run)


class RunTable:
    """Runs by id; every method is one transaction and may block, so callers on the event loop use a thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._listeners: list[Callable[[Run], None]] = []
        self._changing = threading.Lock()  # two threads may change a run: one its state, one where its stem stands

    def listen(self, listener: Callable[[Run], None]) -> None:
        """Call ``listener`` with every run that this process has stored, in the thread that did; it must not wait."""
        self._listeners.append(listener)

    def _tell(self, run: Run) -> None:
        for listener in self._listeners:
            listener(run)

    def insert(self, run: Run) -> Run:
        """Store a new run and return it with its number; it is on disk when this returns."""
        with self._engine.begin() as connection:
            number = connection.execute(insert(TESTS).values(_row(run))).inserted_primary_key
            if number is None:
                raise NotFoundError(
                    say("test_without_number", "test {test}: the database gave it no number", test=run.id)
                )
            stored = replace(run, number=number[0])
            _write_all(connection, stored)
        self._tell(stored)
        return self.get(run.id)

    def save(self, run: Run) -> None:
        """Write the whole run over its former state. Raises NotFoundError where it was never stored.

        Raises ValueError for a run that came from a list: its analysis would be lost.
        """
        if run.analysis is NOT_LOADED:
            raise ValueError(f"test {run.id} came from a list, without its analysis: get it whole before it is saved")
        with self._engine.begin() as connection:
            mine = (TESTS.c.id == run.id) & (TESTS.c.number == run.number)
            if connection.execute(update(TESTS).where(mine).values(_row(run))).rowcount != 1:
                raise NotFoundError(
                    say("test_never_stored", "test {test} is unknown: it was never stored", test=run.id)
                )
            _write_all(connection, run)
        self._tell(run)

    def change(self, run_id: str, changes: Mapping[str, Any]) -> Run:
        """Write what changes in a run, as others left it meanwhile; return it as stored. Raises NotFoundError."""
        with self._changing:
            changed = replace(self.get(run_id), **changes)
            self.save(changed)
        return changed

    def get(self, run_id: str) -> Run:
        """Return one run. Raises NotFoundError."""
        with self._engine.connect() as connection:
            row = connection.execute(_whole().where(TESTS.c.id == run_id)).one_or_none()
        if row is None:
            raise NotFoundError(say("test_unknown", "test {test} is unknown: GET /tests lists all", test=run_id))
        return _run(row)

    def by_idempotency_key(self, key: str) -> Run | None:
        """Return the run that was asked for with this key, if any."""
        with self._engine.connect() as connection:
            row = connection.execute(_whole().where(TESTS.c.idempotency_key == key)).one_or_none()
        return None if row is None else _run(row)

    def newest(
        self, limit: int, *, before: int | None = None, valve: str | None = None, wanted: RunFilter = _ALL
    ) -> list[Run]:
        """Runs with a number below ``before``, newest first, at most ``limit``; their analysis is NOT_LOADED."""
        query = select(TESTS).order_by(TESTS.c.number.desc()).limit(limit).where(*wanted.conditions())
        if before is not None:
            query = query.where(TESTS.c.number < before)
        if valve is not None:
            query = query.where(TESTS.c.valve == valve)
        with self._engine.connect() as connection:
            return [_head(row) for row in connection.execute(query.where(*wanted.narrowed(connection)))]

    def in_states(self, states: Sequence[RunState], *, gateway: str | None = None) -> list[Run]:
        """Runs in one of these states, oldest first; of one gateway where it is named."""
        query = _whole().where(TESTS.c.state.in_([state.value for state in states])).order_by(TESTS.c.number)
        if gateway is not None:
            query = query.where(TESTS.c.gateway == gateway)
        with self._engine.connect() as connection:
            return [_run(row) for row in connection.execute(query)]

    def ended_since(self, since: datetime | None = None, *, valve: str | None = None) -> list[str]:
        """Ids of the runs asked for since an instant that have a recording, oldest first."""
        query = select(TESTS.c.id).where(TESTS.c.recording_sha256.is_not(None)).order_by(TESTS.c.number)
        if since is not None:
            query = query.where(TESTS.c.created_at >= since)
        if valve is not None:
            query = query.where(TESTS.c.valve == valve)
        with self._engine.connect() as connection:
            return list(connection.scalars(query))

    def valve_heads(self, valves: Sequence[str] | None = None) -> dict[str, ValveHead]:
        """Return the last test of each valve, or of these, with the health of its last completed one."""
        states = VALVE_STATES.c
        query = (
            select(TESTS, states.completed_number, states.completed_at, VALVE_HEALTHS.c.health)
            .join_from(VALVE_STATES, TESTS, TESTS.c.number == states.last_number)
            .join(VALVE_HEALTHS, VALVE_HEALTHS.c.valve == states.valve, isouter=True)
        )
        if valves is not None:
            query = query.where(states.valve.in_(valves))
        with self._engine.connect() as connection:
            rows = connection.execute(query).all()
        return {
            row.valve: ValveHead(
                _head(row),
                row.completed_number,
                row.completed_at,
                None if row.health is None else with_sentences(row.health),
            )
            for row in rows
        }

    def last_completed(self, valve: str) -> Run | None:
        """Return the newest completed run of a valve, whole."""
        states = VALVE_STATES.c
        query = _whole().join(VALVE_STATES, TESTS.c.number == states.completed_number).where(states.valve == valve)
        with self._engine.connect() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else _run(row)

    def note_stands(self, run: Run, stands: StandsAt) -> Run:
        """Store where a valve was seen to stand after a run, and nothing else of it; return the run as stored.

        Raises NotFoundError where it was never stored.
        """
        mine = (TESTS.c.id == run.id) & (TESTS.c.number == run.number)
        with self._changing, self._engine.begin() as connection:
            kept = connection.execute(select(TESTS.c[TABLE]).where(mine)).scalar_one_or_none() or {}
            seen = stands.to_json()
            table = kept | with_table(seen).get(TABLE, {})
            if connection.execute(update(TESTS).where(mine).values(stands=seen, messages=table or None)).rowcount != 1:
                raise NotFoundError(
                    say("test_never_stored", "test {test} is unknown: it was never stored", test=run.id)
                )
            is_last = VALVE_STATES.c.last_number == run.number
            connection.execute(update(VALVE_STATES).where(is_last).values(stem=stands.verdict.value))
        stored = self.get(run.id)
        self._tell(stored)
        return stored

    def with_moving_stems(self, gateway: str) -> list[Run]:
        """Return the last tests of a gateway's valves whose stems were not looked at since; analysis NOT_LOADED."""
        query = select(TESTS).join(VALVE_STATES, TESTS.c.number == VALVE_STATES.c.last_number)
        query = query.where(VALVE_STATES.c.stem == StemVerdict.MOVING.value, TESTS.c.gateway == gateway)
        with self._engine.connect() as connection:
            return [_head(row) for row in connection.execute(query)]

    def count_in_doubt(self) -> int:
        """Return how many tests left their valve in doubt, not acknowledged; each bars its valve's next."""
        return self._count_unseen(VALVE_STATES.c.safe_confirmed.is_(False))

    def count_stems_astray(self) -> int:
        """Return how many tests left a stem not seen at its declared safe position, not acknowledged."""
        astray = [verdict.value for verdict in StemVerdict if verdict.is_alarm]
        return self._count_unseen(VALVE_STATES.c.stem.in_(astray))

    def _count_unseen(self, bad: ColumnElement[bool]) -> int:
        states = VALVE_STATES.c
        query = select(func.count()).select_from(VALVE_STATES).join(TESTS, TESTS.c.number == states.last_number)
        with self._engine.connect() as connection:
            return int(connection.execute(query.where(bad, TESTS.c.acknowledged_at.is_(None))).scalar_one())
