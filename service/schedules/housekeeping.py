"""What is done once a day beside the checks: recordings that may go are removed, jobs that ended are forgotten."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Final

import structlog

from service.runs.tasks import Background

_LOG = structlog.get_logger(__name__)
_FIRST_S: Final = 60.0
_PERIOD_S: Final = 86400.0


class Housekeeping(Background):
    """Does ``chores`` a minute after the start and then once a day, in threads; each may block."""

    def __init__(self, chores: Sequence[Callable[[], object]]) -> None:
        super().__init__(self._keep_house)
        self._chores = tuple(chores)

    async def _keep_house(self) -> None:
        pause_s = _FIRST_S
        while True:
            await asyncio.sleep(pause_s)
            pause_s = _PERIOD_S
            for chore in self._chores:
                try:
                    await asyncio.shield(asyncio.to_thread(chore))
                except Exception as error:  # noqa: BLE001  - tomorrow is another day
                    _LOG.error("housekeeping failed", exc_info=error)
