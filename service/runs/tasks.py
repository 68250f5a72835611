"""What a process has under way on its event loop, and how that comes to its end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

import structlog

Result = TypeVar("Result")

_LOG = structlog.get_logger(__name__)
_CANCELLED_S: Final = 5.0
_CANCELLED_AGAIN_S: Final = 0.5


class Background:
    """Work that goes on from ``start`` to ``close``, in a task of its own."""

    def __init__(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self._work = work
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin."""
        self._task = asyncio.create_task(self._work())

    async def close(self) -> None:
        """End; nothing happens where it never began.

        It is cancelled until it has ended: ``asyncio.wait_for`` of Python 3.11 swallows a cancellation that comes as
        what it waits for is done (CPython issue 37658).
        """
        while self._task is not None and not self._task.done():
            self._task.cancel()
            await asyncio.wait({self._task}, timeout=_CANCELLED_AGAIN_S)


class Tasks:
    """The tasks of runs and of recovery; each is kept until it has ended."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()

    def spawn(self, work: Coroutine[Any, Any, Result]) -> asyncio.Task[Result]:
        """Start work that nobody has to wait for."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def settled(self) -> None:
        """Return when all have ended, those included that are started meanwhile."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))

    async def end(self, timeout_s: float) -> None:
        """Wait until all have ended; those that are late are cancelled."""
        if self._tasks:
            _, late = await asyncio.wait(set(self._tasks), timeout=timeout_s)
            for task in late:
                _LOG.error("a test did not end in time", seconds=timeout_s)
                task.cancel()
            if late:  # what is cancelled still sends its valve to safe
                await asyncio.wait(late, timeout=_CANCELLED_S)
