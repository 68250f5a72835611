"""Durable jobs: the one module that knows DBOS. A gateway's queue, one job a bus at a time, kept on disk.

A job is one whole stroke in one step: it is carried out by ``carry_out``, which must itself refuse to begin a job twice
(the rows of ``schedule_runs`` do that). A re-analysis is one job too, beside the buses and behind the last one asked
for; its rows say what is left of it. Nothing is ever cancelled here: a job ends when its function returns.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import structlog
from dbos import DBOS, DBOSConfig, SetEnqueueOptions, SetWorkflowID
from dbos import error as dbos_error
from sqlalchemy import URL
from sqlalchemy.exc import SQLAlchemyError

from valve.errors import ConfigurationError, InternalError
from valve.messages import say

_LOG = structlog.get_logger(__name__)
# Pinned: under another version what is queued would be stranded. To be raised only with a way for what is queued.
_JOBS_VERSION: Final = "nightly-1"
_POLL_S: Final = 0.5
_FEWEST_THREADS: Final = 8
_FORGET_AT_ONCE: Final = 500
_LAST_PRIORITY: Final = 2**31 - 1  # the largest that DBOS takes
_REANALYSES: Final = "\x1freanalyses"  # in the place of a bus; no bus is called so


class _Hook:
    """The queue that runs in this process: DBOS knows functions by name and not objects."""

    def __init__(self) -> None:
        self.carry_out: Callable[[int], str] | None = None
        self.reanalyse: Callable[[int], str] | None = None
        self.lock = threading.Lock()


_HOOK: Final = _Hook()


@DBOS.step(name="stroke")
def _stroke(check_id: int) -> str:
    carry_out = _HOOK.carry_out
    return "the service was ending" if carry_out is None else carry_out(check_id)


@DBOS.workflow(name="nightly_check")
def _nightly_check(check_id: int) -> str:
    return _stroke(check_id)


@DBOS.step(name="analyses")
def _analyses(number: int) -> str:
    reanalyse = _HOOK.reanalyse
    return "the service was ending" if reanalyse is None else reanalyse(number)


@DBOS.workflow(name="reanalysis")
def _reanalysis(number: int) -> str:
    return _analyses(number)


class JobQueue:
    """The jobs of one gateway: in ``folder`` by SQLite, or in the PostgreSQL database that ``url`` names.

    One a process. ``carry_out`` gets a job's check in a thread of its own, ``reanalyse`` the number of a re-analysis.
    All methods may block.
    """

    def __init__(
        self,
        folder: Path,
        url: URL | None,
        gateway: str,
        buses: int,
        carry_out: Callable[[int], str],
        *,
        reanalyse: Callable[[int], str] | None = None,
    ) -> None:
        self._queue = f"gateway-{gateway}" if gateway else "gateway"
        self._carry_out = carry_out
        self._reanalyse = reanalyse
        self._config: DBOSConfig = {
            "name": "breakaway",
            "application_version": _JOBS_VERSION,
            "executor_id": gateway or "gateway",
            "log_level": "WARNING",
            "max_executor_threads": max(_FEWEST_THREADS, 2 * buses + 2),
            "notification_listener_polling_interval_sec": _POLL_S,
        }
        if url is None:
            # Debian 12's Python has SQLite 3.40, DBOS needs 3.42: pysqlite3 brings its own.
            from pysqlite3 import dbapi2  # noqa: PLC0415  - a plant on PostgreSQL needs none

            self._config["system_database_url"] = f"sqlite:///{folder / 'jobs.db'}"
            self._config["db_engine_kwargs"] = {"module": dbapi2}
        else:
            self._config["system_database_url"] = url.render_as_string(hide_password=False)
            self._config["sys_db_pool_size"] = 4

    def start(self) -> None:
        """Open the queue; what a former process left in it is taken up.

        Raises ConfigurationError where its database cannot be used, InternalError where this process has one already.
        """
        if not _HOOK.lock.acquire(blocking=False):
            raise InternalError(say("second_queue", "a second queue of jobs in one process: report it"))
        try:
            _HOOK.carry_out, _HOOK.reanalyse = self._carry_out, self._reanalyse
            DBOS(config=self._config)
            DBOS.listen_queues([self._queue])
            DBOS.launch()
            DBOS.register_queue(
                self._queue, partition_concurrency=1, polling_interval_sec=_POLL_S, on_conflict="always_update"
            )
        except (SQLAlchemyError, dbos_error.DBOSException, OSError) as error:
            self._end()
            reason = " ".join(str(error).split())[:200]
            raise ConfigurationError(
                say(
                    "queue_unopened",
                    "the queue of durable jobs cannot be opened ({kind}: {reason}): restore jobs.db of service.store "
                    "from a backup or remove it, or see to service.database",
                    kind=type(error).__name__,
                    reason=reason,
                )
            ) from None  # its context may show the database's password
        except BaseException:
            self._end()
            raise

    def enqueue(self, job_id: str, bus: str, check_id: int) -> None:
        """Put a check into the queue of its bus; a job of this id is never put there twice.

        Jobs of a bus come in the order of their checks, those of one millisecond too.
        """
        priority = min(check_id, _LAST_PRIORITY)  # the smaller comes first; equal ones by the time of their coming
        with SetWorkflowID(job_id), SetEnqueueOptions(queue_partition_key=bus, priority=priority):
            DBOS.enqueue_workflow(self._queue, _nightly_check, check_id)

    def enqueue_reanalysis(self, job_id: str, number: int) -> None:
        """Put a re-analysis into the queue, behind the others; a job of this id is never put there twice."""
        with SetWorkflowID(job_id), SetEnqueueOptions(queue_partition_key=_REANALYSES, priority=number):
            DBOS.enqueue_workflow(self._queue, _reanalysis, number)

    def forget(self, before: datetime) -> int:
        """Remove jobs that ended before an instant; return how many."""
        removed = 0
        instant = before.astimezone(UTC).isoformat()
        while jobs := self._ended(instant):
            DBOS.delete_workflows(jobs)
            removed += len(jobs)
        return removed

    def _ended(self, before: str) -> list[str]:
        listed: list[Any] = DBOS.list_workflows(
            status=["SUCCESS", "ERROR"],
            queue_name=self._queue,
            completed_before=before,
            limit=_FORGET_AT_ONCE,
            load_input=False,
            load_output=False,
        )
        return [job.workflow_id for job in listed]

    def close(self) -> None:
        """Take up nothing more. Jobs under way must have been told to end before."""
        if _HOOK.carry_out is self._carry_out:
            self._end()

    def _end(self) -> None:
        _HOOK.carry_out = _HOOK.reanalyse = None
        try:
            DBOS.destroy()
        finally:
            _HOOK.lock.release()
