"""Re-analyses in the database: the only module that turns their rows into data and back."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, Final

from sqlalchemy import ColumnElement, Engine, Row, Select, and_, exists, func, insert, literal, or_, select, update

from drivers.outcome import Ended
from service.model.reanalysis import Found, Reanalysis, ReanalysisProgress, Repeat, RepeatState, Wanted
from service.model.run import ENDED_KEY, RunState
from service.store.run_filter import RunFilter
from service.store.schema_health import FIGURES
from service.store.schema_reanalyses import REANALYSES, REPEATS
from service.store.schema_tests import TESTS
from service.store.sentences import with_reason, with_sentences
from valve.errors import NotFoundError
from valve.messages import say

_TROUBLES: Final = 20
_OPEN: Final = (RepeatState.QUEUED.value, RepeatState.RUNNING.value)


def _reanalysis(row: Row[Any]) -> Reanalysis:
    values = dict(row._mapping)
    wanted = Wanted(*(values.pop(name) for name in ("since", "until", "valve", "older_only")))
    return Reanalysis(wanted, **values)


def _repeat(row: Row[Any]) -> Repeat:
    values = with_sentences(dict(row._mapping))
    return Repeat(**(values | {"state": RepeatState(values["state"])}))


def _repeats() -> Select[Any]:
    table = REPEATS.c
    names = ("id", "test_id", "valve", "state", "attempt", "begun_at", "reason", "messages")
    return select(*(table[name] for name in names))


def _meant(wanted: Wanted, failed: str, engine: int) -> list[ColumnElement[bool]]:
    """Return what a test's row must meet: it ended, and its motion ended well; the rest is seen at its turn."""
    tests = TESTS.c
    chosen = RunFilter(wanted.valve, since=wanted.since, until=wanted.until).conditions()
    failed_afterwards = and_(tests.state == RunState.FAILED.value, tests.error.startswith(failed, autoescape=True))
    cut_off = and_(
        tests.state == RunState.INTERRUPTED.value,
        tests.safe_confirmed.is_(True),
        tests.quality[ENDED_KEY].as_string() == Ended.COMPLETED.value,
    )
    conditions = [*chosen, or_(tests.state == RunState.COMPLETED.value, failed_afterwards, cut_off)]
    if wanted.older_only:
        present = exists().where(FIGURES.c.number == tests.number, FIGURES.c.engine == engine)
        conditions.append(~present)
    return conditions


def _is_queued() -> ColumnElement[bool]:
    """Whether a re-analysis that has not ended has this test."""
    return exists().where(REPEATS.c.test_id == TESTS.c.id, REPEATS.c.state.in_(_OPEN))


class ReanalysisTable:
    """Re-analyses by id; every method is one transaction and may block, so callers on the event loop use a thread.

    ``failed`` is how the reason of a test begins whose analysis alone failed, ``engine`` the present one.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def find(self, wanted: Wanted, gateway: str, *, failed: str, engine: int) -> Found:
        """Return what there is to do for a request on this gateway."""
        tests = TESTS.c
        has = tests.recording_sha256.is_not(None).label("has")
        meant = (
            select(tests.gateway, has, _is_queued().label("queued"))
            .where(*_meant(wanted, failed, engine))
            .subquery("meant")
        )
        query = select(meant.c.gateway, meant.c.has, meant.c.queued, func.count().label("count"))
        query = query.group_by(meant.c.gateway, meant.c.has, meant.c.queued)
        here = gone = queued = 0
        elsewhere: dict[str, int] = {}
        with self._engine.connect() as connection:
            for name, has, is_queued, count in connection.execute(query):
                if name != gateway:
                    elsewhere[name] = elsewhere.get(name, 0) + count
                elif not has:
                    gone += count
                elif is_queued:
                    queued += count
                else:
                    here += count
        return Found(here, elsewhere, gone, queued)

    def insert(self, reanalysis: Reanalysis, *, failed: str, engine: int) -> Reanalysis:
        """Store a re-analysis with its tests, oldest first, but for those that another one still has queued."""
        wanted, tests = reanalysis.wanted, TESTS.c
        values = {
            "gateway": reanalysis.gateway,
            "since": wanted.since,
            "until": wanted.until,
            "valve": wanted.valve,
            "older_only": wanted.older_only,
            "software": reanalysis.software,
            "requested_by": reanalysis.requested_by,
            "asked_at": reanalysis.asked_at,
        }
        with self._engine.begin() as connection:
            key = connection.execute(insert(REANALYSES).values(values)).inserted_primary_key
            if key is None:
                raise NotFoundError(say("reanalysis_without_number", "the re-analysis: the database gave it no number"))
            conditions = _meant(wanted, failed, engine)
            mine = (tests.gateway == reanalysis.gateway) & tests.recording_sha256.is_not(None)
            rows = (
                select(literal(key[0]), tests.id, tests.valve, literal(RepeatState.QUEUED.value), literal(""))
                .where(mine, *conditions, ~_is_queued())
                .order_by(tests.number)
            )
            names = ["reanalysis", "test_id", "valve", "state", "reason"]
            connection.execute(insert(REPEATS).from_select(names, rows))
        return self.get(key[0])

    def get(self, number: int) -> Reanalysis:
        """Return one re-analysis. Raises NotFoundError."""
        with self._engine.connect() as connection:
            row = connection.execute(select(REANALYSES).where(REANALYSES.c.id == number)).one_or_none()
        if row is None:
            raise NotFoundError(
                say("reanalysis_unknown", "re-analysis {number} is unknown: GET /reanalyses lists them", number=number)
            )
        return _reanalysis(row)

    def unfinished(self, gateway: str) -> list[Reanalysis]:
        """Return the re-analyses of a gateway that have not ended, oldest first."""
        table = REANALYSES.c
        query = select(REANALYSES).where(table.gateway == gateway, table.ended_at.is_(None)).order_by(table.id)
        with self._engine.connect() as connection:
            return [_reanalysis(row) for row in connection.execute(query)]

    def newest(self, limit: int) -> list[Reanalysis]:
        """Return the newest re-analyses, of all gateways, newest first."""
        query = select(REANALYSES).order_by(REANALYSES.c.id.desc()).limit(limit)
        with self._engine.connect() as connection:
            return [_reanalysis(row) for row in connection.execute(query)]

    def progress(self, reanalysis: Reanalysis) -> ReanalysisProgress:
        """Return how far a re-analysis is, with the first of its tests that came to nothing."""
        mine = REPEATS.c.reanalysis == reanalysis.id
        counted = select(REPEATS.c.state, func.count()).where(mine).group_by(REPEATS.c.state)
        bad = REPEATS.c.state.in_([RepeatState.FAILED.value, RepeatState.SKIPPED.value])
        troubled = _repeats().where(mine, bad).order_by(REPEATS.c.id).limit(_TROUBLES)
        with self._engine.connect() as connection:
            counts = {RepeatState(state): int(count) for state, count in connection.execute(counted)}
            troubles = [_repeat(row) for row in connection.execute(troubled)]
        return ReanalysisProgress(reanalysis, counts, troubles)

    def take_up(self, number: int, attempt: str, now: datetime, *, without: Sequence[str]) -> Repeat | None:
        """Mark the oldest queued test as running and return it; None where none is queued of any other valve."""
        table = REPEATS.c
        queued = (table.reanalysis == number) & (table.state == RepeatState.QUEUED.value)
        query = select(table.id).where(queued, table.valve.not_in(without)).order_by(table.id).limit(1)
        with self._engine.begin() as connection:
            found = connection.scalars(query).first()
            if found is None:
                return None
            values = {"state": RepeatState.RUNNING.value, "attempt": attempt, "begun_at": now}
            connection.execute(update(REPEATS).where(table.id == found, queued).values(values))
            return _repeat(connection.execute(_repeats().where(table.id == found)).one())

    def running(self, number: int) -> list[Repeat]:
        """Return the tests of a re-analysis that were taken up and have not ended."""
        mine = (REPEATS.c.reanalysis == number) & (REPEATS.c.state == RepeatState.RUNNING.value)
        with self._engine.connect() as connection:
            return [_repeat(row) for row in connection.execute(_repeats().where(mine).order_by(REPEATS.c.id))]

    def put_back(self, repeat: Repeat) -> None:
        """Queue a test again that was taken up and whose analysis was not begun."""
        self._change(repeat, state=RepeatState.QUEUED.value, attempt=None, begun_at=None)

    def end_test(self, repeat: Repeat, state: RepeatState, reason: str, now: datetime) -> None:
        """Write down how a test of a re-analysis ended."""
        self._change(repeat, state=state.value, ended_at=now, **with_reason(reason))

    def _change(self, repeat: Repeat, **values: Any) -> None:
        mine = (REPEATS.c.id == repeat.id) & (REPEATS.c.state == RepeatState.RUNNING.value)
        with self._engine.begin() as connection:
            connection.execute(update(REPEATS).where(mine).values(values))

    def stop(self, number: int, who: str, now: datetime) -> bool:
        """Take what is queued out of a re-analysis; False where it had ended already."""
        mine = (REANALYSES.c.id == number) & REANALYSES.c.ended_at.is_(None)
        queued = (REPEATS.c.reanalysis == number) & (REPEATS.c.state == RepeatState.QUEUED.value)
        with self._engine.begin() as connection:
            if connection.execute(update(REANALYSES).where(mine).values(stopped_by=who)).rowcount != 1:
                return False
            connection.execute(update(REPEATS).where(queued).values(state=RepeatState.STOPPED.value, ended_at=now))
            return True

    def end(self, number: int, now: datetime) -> bool:
        """Write down that a re-analysis has ended; False where a test of it is still to be done."""
        left = exists().where(REPEATS.c.reanalysis == number, REPEATS.c.state.in_(_OPEN))
        mine = (REANALYSES.c.id == number) & REANALYSES.c.ended_at.is_(None)
        with self._engine.begin() as connection:
            return connection.execute(update(REANALYSES).where(mine, ~left).values(ended_at=now)).rowcount == 1
