"""Retention: recordings that may go are removed, what was removed is written down, results stay."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any, Final

import structlog
from sqlalchemy import func, insert, select, update

from service.config.plant import Retention
from service.model.acknowledgement import ended_badly
from service.store.schema_health import BASELINES
from service.store.schema_nightly import REMOVED_RECORDINGS
from service.store.schema_tests import TESTS
from service.store.store import Store
from valve.messages import say

_LOG = structlog.get_logger(__name__)
_SWEEP: Final = timedelta(days=7)  # a file whose removal was written down and then cut off is looked for this long


def remove_old_recordings(store: Store, rule: Retention, now: datetime) -> list[str]:
    """Remove the recordings of this gateway that ``rule`` lets go; return the ids of their tests. Blocks.

    Kept whatever their age: the newest ``keep_last`` of each valve, a test that ended badly and that nobody has
    acknowledged, and with ``keep_baselines`` what a valve is compared with and what is labelled as found or as left.
    """
    _sweep(store, now)
    removed, baselines = [], _baselines(store) if rule.keep_baselines else set()
    for run_id in _candidates(store, rule, now):
        run = store.runs.get(run_id)
        if ended_badly(run) and run.acknowledged_at is None:
            continue
        if rule.keep_baselines and (run.label is not None or run_id in baselines):
            continue
        why = say(
            "older_than_kept",
            "older than {days} days, not among the last {n}",
            days=rule.recordings_days,
            n=rule.keep_last,
        )
        _remove(store, run_id, why, now)
        removed.append(run_id)
    if removed:
        _LOG.info("recordings removed", count=len(removed), older_than_days=rule.recordings_days)
    return removed


def _candidates(store: Store, rule: Retention, now: datetime) -> list[str]:
    rank = func.row_number().over(partition_by=TESTS.c.valve, order_by=TESTS.c.number.desc())
    ranked = (
        select(TESTS.c.id, TESTS.c.number, TESTS.c.created_at, rank.label("place"))
        .where(TESTS.c.recording_file.is_not(None), TESTS.c.gateway == store.gateway)
        .subquery()
    )
    oldest = now - timedelta(days=rule.recordings_days)
    query = select(ranked.c.id).where(ranked.c.place > rule.keep_last, ranked.c.created_at < oldest)
    with store.engine.connect() as connection:
        return list(connection.scalars(query.order_by(ranked.c.number)))


def _baselines(store: Store) -> set[str]:
    with store.engine.connect() as connection:
        return set(connection.scalars(select(BASELINES.c.test_id)))


def _remove(store: Store, run_id: str, rule: str, now: datetime) -> None:
    """Write the removal down, then remove: what is cut off in between is finished by the next sweep."""
    path = store.recording_path(run_id)
    values: dict[str, Any] = {"test_id": run_id, "removed_at": now, "rule": rule}
    values["bytes"] = path.stat().st_size if path.exists() else 0
    mine = TESTS.c.id == run_id
    with store.engine.begin() as connection:
        values["sha256"] = connection.execute(select(TESTS.c.recording_sha256).where(mine)).scalar_one() or ""
        connection.execute(insert(REMOVED_RECORDINGS).values(values))
        connection.execute(update(TESTS).where(mine).values(recording_file=None, recording_sha256=None))
    path.unlink(missing_ok=True)


def _sweep(store: Store, now: datetime) -> None:
    query = select(REMOVED_RECORDINGS.c.test_id).where(REMOVED_RECORDINGS.c.removed_at >= now - _SWEEP)
    with store.engine.connect() as connection:
        for run_id in connection.scalars(query):
            store.recording_path(run_id).unlink(missing_ok=True)
