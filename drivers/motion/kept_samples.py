"""Samples on their way from the wire to the journal and then to whoever watches, without the event loop waiting."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from drivers.motion.journal import JournalWriter
from drivers.outcome import SampleBlock
from valve.messages import say

_SYNC_PERIOD_S: Final = 1.0
_LONGEST_S: Final = 5.0  # that samples may wait for the disk; then it counts as broken


class KeptSamples:
    """The journal of one test, in a thread of its own: neither a busy disk nor a full pool of threads holds up a valve.

    ``on_written`` is called on the event loop with each block of samples once the operating system has it, in order;
    ``on_error`` when they cannot be written, or not in time. All methods belong to the event loop.
    """

    def __init__(
        self, path: Path, on_written: Callable[[SampleBlock], None], on_error: Callable[[OSError], None]
    ) -> None:
        self._path = path
        self._on_written = on_written
        self._on_error = on_error
        self._loop = asyncio.get_running_loop()
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._journal: JournalWriter | None = None
        self._waiting_s: list[float] = []  # since when each block waits that is not written yet
        self._synced_s = time.monotonic()

    async def begin(self, header: Mapping[str, Any]) -> None:
        """Begin the journal; its header is on disk when this returns. Raises OSError."""
        self._journal = await self._loop.run_in_executor(self._thread, JournalWriter, self._path, header)

    async def note_commanded(self) -> None:
        """Write that the valve may move from now on; it is on disk when this returns. Raises OSError."""
        assert self._journal is not None
        await self._loop.run_in_executor(self._thread, self._journal.note_commanded)

    def add(self, block: SampleBlock) -> None:
        """Hand samples on to the thread; returns at once."""
        now_s = time.monotonic()
        if self._waiting_s and now_s - self._waiting_s[0] > _LONGEST_S:
            self._on_error(
                TimeoutError(
                    say(
                        "disk_has_not_taken",
                        "the disk has not taken them for {time:.2g s}",
                        time=now_s - self._waiting_s[0],
                    )
                )
            )
            return
        assert self._journal is not None
        self._waiting_s.append(now_s)
        self._thread.submit(self._write, self._journal, block)

    async def drained(self) -> None:
        """Return when all samples so far are written and shown, or the disk takes too long."""
        assert self._journal is not None
        try:
            async with asyncio.timeout(_LONGEST_S):
                await self._loop.run_in_executor(self._thread, self._sync, self._journal)
        except TimeoutError:
            self._on_error(
                TimeoutError(say("disk_did_not_take", "the disk has not taken them within {time:g s}", time=_LONGEST_S))
            )
        except OSError as error:
            self._on_error(error)

    def close(self) -> None:
        """Close the journal when what was handed on is written; returns at once, also where it was done already."""
        journal, self._journal = self._journal, None
        if journal is not None:
            self._thread.submit(journal.close)
        self._thread.shutdown(wait=False)

    # ---- in the thread

    def _write(self, journal: JournalWriter, block: SampleBlock) -> None:
        error: OSError | None = None
        try:
            journal.append(block)
        except OSError as problem:
            error = problem
        self._loop.call_soon_threadsafe(self._done, block, error)
        if error is None and time.monotonic() - self._synced_s > _SYNC_PERIOD_S:
            try:
                self._sync(journal)
            except OSError as problem:
                self._loop.call_soon_threadsafe(self._on_error, problem)

    def _sync(self, journal: JournalWriter) -> None:
        self._synced_s = time.monotonic()
        journal.sync()

    # ---- on the event loop again

    def _done(self, block: SampleBlock, error: OSError | None) -> None:
        self._waiting_s.pop(0)
        if error is None:
            self._on_written(block)
        else:
            self._on_error(error)
