"""How many valves are polled now: what else needs a processor leaves room for them meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager


class Polling:
    """Counts the motions that are sampled by requests. All methods belong to the event loop."""

    def __init__(self) -> None:
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
        try:
            yield
        finally:
            self._motions -= 1
            if not self._motions:
                self.tell()

    def tell(self) -> None:
        """Let everybody look anew who waits for a change."""
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def change(self) -> None:
        """Return when the polling has ended, or when ``tell`` says that something else changed."""
        await self._changed.wait()
