"""What is done once a day beside the checks: recordings that may go are removed, jobs that ended are forgotten."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from typing import Final

import structlog

_LOG = structlog.get_logger(__name__)
_FIRST_S: Final = 60.0
_PERIOD_S: Final = 86400.0


class Housekeeping:
    """Does ``chores`` a minute after the start and then once a day, in threads; each may block."""

    def __init__(self, chores: Sequence[Callable[[], object]]) -> None:
        self._chores = tuple(chores)
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; without a chore there is nothing to do."""
        if self._chores:
            self._task = asyncio.create_task(self._work())

    async def close(self) -> None:
        """End; a chore under way is waited for."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def _work(self) -> None:
        pause_s = _FIRST_S
        while True:
            await asyncio.sleep(pause_s)
            pause_s = _PERIOD_S
            for chore in self._chores:
                try:
                    await asyncio.shield(asyncio.to_thread(chore))
                except Exception as error:  # noqa: BLE001  - tomorrow is another day
                    _LOG.error("housekeeping failed", exc_info=error)
