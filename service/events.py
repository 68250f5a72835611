"""What happens during a run, in order, for everybody who watches: a bounded log that many can follow."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

_KEPT_EVENTS: Final = 4096  # 5 minutes of progress and samples at 10 a second each


@dataclass(frozen=True, slots=True)
class Event:
    """One event; ids count from 1 within their log."""

    id: int
    kind: str
    data: Mapping[str, Any]


class EventLog:
    """Appended to by one run, followed by any number of readers, each at its own pace.

    A reader that falls behind by more than the log keeps misses the oldest events: nobody slows the run down.
    """

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=_KEPT_EVENTS)
        self._latest = 0
        self._changed = asyncio.Event()
        self.closed = False

    def append(self, kind: str, data: Mapping[str, Any]) -> None:
        """Add an event and wake all readers."""
        self._latest += 1
        self._events.append(Event(self._latest, kind, data))
        self._wake()

    def close(self) -> None:
        """Say that nothing more will come."""
        self.closed = True
        self._wake()

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def follow(self, after: int = 0, *, idle_s: float = 15.0) -> AsyncIterator[Event | None]:
        """Events with an id above ``after`` until the log is closed; None after ``idle_s`` without one."""
        if after > self._latest:  # an id from before a restart
            after = 0
        while True:
            changed = self._changed
            fresh = min(self._latest - after, len(self._events))
            for event in list(islice(self._events, len(self._events) - fresh, None)):
                after = event.id
                yield event
            if changed is not self._changed:
                continue
            if self.closed:
                return
            try:
                await asyncio.wait_for(changed.wait(), idle_s)
            except TimeoutError:
                yield None
