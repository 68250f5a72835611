"""Pictures drawn in another process, and the last of them kept: the event loop and its neighbours keep their time.

That process runs at a lower priority: loading what draws takes seconds of a core, which a polled valve may need.
"""

from __future__ import annotations

import asyncio
import multiprocessing
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from typing import Any, Final, ParamSpec

from service.workers.priority import stand_back

Parameters = ParamSpec("Parameters")

_KEPT_PICTURES: Final = 128  # of at most 40 kB each


def _draw(module: str, name: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(import_module(module), name)(*arguments)


class Drawer:
    """One worker process, started at the first picture and started anew where it died."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._drawn: OrderedDict[Hashable, asyncio.Task[str | None]] = OrderedDict()

    async def svg(
        self, key: Hashable, draw: Callable[Parameters, str | None], *args: Parameters.args, **_: Parameters.kwargs
    ) -> str | None:
        """Return the picture that ``draw`` (a function of a module) makes of ``args``; the same key draws it once."""
        task = self._drawn.get(key)
        if task is None or (task.done() and (task.cancelled() or task.exception() is not None)):
            task = asyncio.create_task(self._drawn_elsewhere(draw.__module__, draw.__name__, args))
            self._drawn[key] = task
            while len(self._drawn) > _KEPT_PICTURES:
                self._drawn.popitem(last=False)
        self._drawn.move_to_end(key)
        return await asyncio.shield(task)  # who no longer wants it does not take it from the others

    async def document(
        self, write: Callable[Parameters, bytes], *args: Parameters.args, **_: Parameters.kwargs
    ) -> bytes:
        """Return what ``write`` (a function of a module) makes of ``args``; nothing is kept."""
        written: bytes = await self._drawn_elsewhere(write.__module__, write.__name__, args)
        return written

    async def _drawn_elsewhere(self, module: str, name: str, args: tuple[Any, ...]) -> Any:
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(self._workers(), _draw, module, name, args)
        except BrokenProcessPool:
            self._pool = None
            return await loop.run_in_executor(self._workers(), _draw, module, name, args)

    def _workers(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), stand_back)
        return self._pool

    async def close(self) -> None:
        """End the worker."""
        for task in self._drawn.values():
            task.cancel()
        await asyncio.gather(*self._drawn.values(), return_exceptions=True)
        if self._pool is not None:
            await asyncio.to_thread(self._pool.shutdown, cancel_futures=True)
            self._pool = None
