"""Schedules and re-analyses of a service from its start to its end, with the queue that carries them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Final

from service.config.plant import Plant
from service.runs.reanalyses import Reanalyses
from service.runs.service import Runs
from service.schedules.housekeeping import Housekeeping
from service.schedules.nightly import Nightly, wall_clock
from service.store.retention import remove_old_recordings
from service.store.store import Store

if TYPE_CHECKING:
    from service.schedules.jobs import JobQueue

_REMEMBERED: Final = timedelta(days=7)  # jobs that ended: their checks stay in the store for ever


class _Queue:
    """The durable queue of a service, opened when it is first needed: most of a second and its threads."""

    def __init__(self, make: Callable[[], JobQueue]) -> None:
        self._make = make
        self._lock = asyncio.Lock()
        self._opening: asyncio.Future[None] | None = None
        self.made: JobQueue | None = None

    async def opened(self) -> JobQueue:
        """Return the queue, open. Raises ConfigurationError."""
        async with self._lock:
            if self._opening is None or (self._opening.done() and self._opening.exception() is not None):
                self.made = await asyncio.to_thread(self._make)
                self._opening = asyncio.ensure_future(asyncio.to_thread(self.made.start))
            await asyncio.shield(self._opening)
        assert self.made is not None
        return self.made

    async def enqueue_reanalysis(self, job_id: str, number: int) -> None:
        """Put a re-analysis into the queue."""
        queue = await self.opened()
        await asyncio.to_thread(queue.enqueue_reanalysis, job_id, number)

    def forget(self) -> None:
        """Remove the jobs that ended long ago. Blocks."""
        if self.made is not None:
            self.made.forget(wall_clock() - _REMEMBERED)

    async def close(self) -> None:
        """Close what was opened; a start that was cancelled goes on in its thread, and is closed too."""
        if self.made is not None and self._opening is not None:
            await asyncio.wait({self._opening})
            await asyncio.to_thread(self.made.close)


@asynccontextmanager
async def running_schedules(
    nightly: Nightly, reanalyses: Reanalyses, plant: Plant, store: Store, runs: Runs
) -> AsyncIterator[None]:
    """Watch the clock, and carry out what was queued, while the service serves.

    A plant without schedules has no queue before a re-analysis is asked for. On the way out nothing further begins, and
    every run is stopped. Raises ConfigurationError.
    """
    await nightly.prepare()
    queue = _Queue(lambda: _job_queue(plant, store, nightly, reanalyses))
    housekeeping = Housekeeping(_chores(plant, store, queue))
    try:
        if plant.schedules:
            await nightly.start(await queue.opened())
        await reanalyses.start(queue.enqueue_reanalysis)
        housekeeping.start()
        yield
    finally:
        nightly.stop_waiting()
        reanalyses.stop_waiting()
        await housekeeping.close()
        await runs.shut_down()
        await nightly.close()
        await reanalyses.close()
        await queue.close()


def _job_queue(plant: Plant, store: Store, nightly: Nightly, reanalyses: Reanalyses) -> JobQueue:
    from service.schedules.jobs import JobQueue  # noqa: PLC0415  - half a second that a plant without schedules does not wait

    database = plant.service.database
    url = None if database is None else database.with_password()
    return JobQueue(
        store.folder,
        url,
        plant.service.gateway,
        len(plant.buses),
        nightly.carry_out_in_thread,
        reanalyse=reanalyses.carry_out_in_thread,
    )


def _chores(plant: Plant, store: Store, queue: _Queue) -> list[Callable[[], object]]:
    chores: list[Callable[[], object]] = [queue.forget]
    rule = plant.service.retention
    if rule is not None:
        chores.append(lambda: remove_old_recordings(store, rule, wall_clock()))
    return chores
