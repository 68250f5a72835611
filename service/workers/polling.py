"""How many valves are polled now: what else needs a processor leaves room for them meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from service.workers.precedence import Precedence


class Polling:
    """Counts the motions that are sampled from here. All methods belong to the event loop.

    While there are any this process has ``precedence``, where one is given.
    """

    def __init__(self, precedence: Precedence | None = None) -> None:
        self.precedence = precedence
        self._motions = 0
        self._changed = asyncio.Event()

    @property
    def goes_on(self) -> bool:
        """Whether a valve is polled now."""
        return self._motions > 0

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Count a motion while the context lasts."""
        self._motions += 1
        if self.precedence is not None:
            self.precedence.begin()
        try:
            yield
        finally:
            self._motions -= 1
            if not self._motions:
                if self.precedence is not None:
                    self.precedence.end()
                self.tell()

    def tell(self) -> None:
        """Let everybody look anew who waits for a change."""
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def change(self) -> None:
        """Return when the polling has ended, or when ``tell`` says that something else changed."""
        await self._changed.wait()
