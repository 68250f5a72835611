"""What happens during a run, in order, for everybody who watches: a bounded log that many can follow."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, Final

_KEPT_EVENTS: Final = 4096  # 5 minutes of progress and samples at 10 a second each
_GATHERED_S: Final = 0.1  # an eye sees no more often; each time costs a write to every watcher
_AT_ONCE: Final = frozenset({"state", "end"})
_MOST_AT_ONCE: Final = 256  # about 60 kB: the event loop is not held up by who begins to watch late


@dataclass(frozen=True)
class Event:
    """One event; ids count from 1 within their log."""

    id: int
    kind: str
    data: Mapping[str, Any]

    @cached_property
    def wire(self) -> bytes:
        """The event as a stream of server-sent events has it; made once, however many watch."""
        return f"id: {self.id}\nevent: {self.kind}\ndata: {json.dumps(self.data, allow_nan=False)}\n\n".encode()


class EventLog:
    """Appended to by one run, followed by any number of readers, each at its own pace.

    A reader that falls behind by more than the log keeps misses the oldest events: nobody slows the run down.
    """

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=_KEPT_EVENTS)
        self._latest = 0
        self._changed = asyncio.Event()
        self._waking: asyncio.TimerHandle | None = None
        self.closed = False

    def append(self, kind: str, data: Mapping[str, Any]) -> None:
        """Add an event; readers hear of a change of state at once, of others at most ten times a second."""
        self._latest += 1
        self._events.append(Event(self._latest, kind, data))
        if kind in _AT_ONCE:
            self._wake()
        elif self._waking is None:
            self._waking = asyncio.get_running_loop().call_later(_GATHERED_S, self._wake)

    def close(self) -> None:
        """Say that nothing more will come."""
        self.closed = True
        self._wake()

    def _wake(self) -> None:
        if self._waking is not None:
            self._waking.cancel()
            self._waking = None
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def follow(self, after: int = 0, *, idle_s: float = 15.0) -> AsyncIterator[tuple[Event, ...]]:
        """Events with an id above ``after`` until the log is closed, all that are there at once.

        None of them (an empty tuple) comes after ``idle_s`` without one.
        """
        if after > self._latest:  # an id from before a restart
            after = 0
        while True:
            changed = self._changed
            fresh = min(self._latest - after, len(self._events))
            if fresh:
                start = len(self._events) - fresh
                events = tuple(islice(self._events, start, start + _MOST_AT_ONCE))
                after = events[-1].id
                yield events
                continue
            if self.closed:
                return
            with suppress(TimeoutError):
                async with asyncio.timeout(idle_s):
                    await changed.wait()
                continue
            yield ()
