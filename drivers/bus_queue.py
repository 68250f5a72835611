"""Who may use a bus next: one at a time, in order of arrival, a stop before all others."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator


class BusQueue:
    """Two locks of asyncio, which serve in order of arrival and lose no turn by a cancellation.

    Ordinary callers queue at ``_ordinary``, so that one of them at most stands at the bus itself; a stop goes there at
    once, and that one lets it go first.
    """

    def __init__(self) -> None:
        self._bus = asyncio.Lock()
        self._ordinary = asyncio.Lock()
        self._stops = 0  # that wait for the bus

    @contextlib.asynccontextmanager
    async def hold(self, *, priority: bool = False) -> AsyncIterator[None]:
        """Hold the bus for the length of the block; wait until it is free, with ``priority`` before all others."""
        await (self._first() if priority else self._in_turn())
        try:
            yield
        finally:
            self._bus.release()

    @property
    def stop_waits(self) -> bool:
        """Whether somebody waits who goes before all others."""
        return self._stops > 0

    async def _first(self) -> None:
        self._stops += 1
        try:
            await self._bus.acquire()
        finally:
            self._stops -= 1

    async def _in_turn(self) -> None:
        async with self._ordinary:
            await self._bus.acquire()
            while self._stops:  # one came while this caller waited: it stands next in the lock's own order
                self._bus.release()
                await asyncio.sleep(0)  # also one that was cancelled needs a moment to go
                await self._bus.acquire()
