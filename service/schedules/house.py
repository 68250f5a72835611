"""The schedules of a service from its start to its end, with the queue that carries them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Final

from service.config.settings import Plant
from service.runs.service import Runs
from service.schedules.housekeeping import Housekeeping
from service.schedules.nightly import Nightly, wall_clock
from service.store.retention import remove_old_recordings
from service.store.store import Store

if TYPE_CHECKING:
    from service.schedules.jobs import JobQueue

_REMEMBERED: Final = timedelta(days=7)  # jobs that ended: their checks stay in the store for ever


@asynccontextmanager
async def nights(nightly: Nightly, plant: Plant, store: Store, runs: Runs) -> AsyncIterator[None]:
    """Watch the clock while the service serves. A plant without schedules has no queue, and none is opened.

    On the way out nothing further begins, and every run is stopped. Raises ConfigurationError.
    """
    await nightly.prepare()
    queue = _queue(plant, store, nightly)
    housekeeping = Housekeeping(_chores(plant, store, queue))
    opening: asyncio.Future[None] | None = None
    try:
        if queue is not None:
            opening = asyncio.ensure_future(asyncio.to_thread(queue.start))
            await asyncio.shield(opening)
            await nightly.start(queue)
        housekeeping.start()
        yield
    finally:
        nightly.stop_waiting()
        await housekeeping.close()
        await runs.shut_down()
        await nightly.close()
        if queue is not None and opening is not None:
            await asyncio.wait({opening})  # a start that was cancelled goes on in its thread: close what it opens
            await asyncio.to_thread(queue.close)


def _queue(plant: Plant, store: Store, nightly: Nightly) -> JobQueue | None:
    if not plant.schedules:
        return None
    from service.schedules.jobs import JobQueue  # noqa: PLC0415  - half a second that a plant without schedules does not wait

    database = plant.service.database
    url = None if database is None else database.with_password()
    return JobQueue(store.folder, url, plant.service.gateway, len(plant.buses), nightly.carry_out_in_thread)


def _chores(plant: Plant, store: Store, queue: JobQueue | None) -> list[Callable[[], object]]:
    chores: list[Callable[[], object]] = []
    rule = plant.service.retention
    if rule is not None:
        chores.append(lambda: remove_old_recordings(store, rule, wall_clock()))
    if queue is not None:
        chores.append(lambda: queue.forget(wall_clock() - _REMEMBERED))
    return chores
