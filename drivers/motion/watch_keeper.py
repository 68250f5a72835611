"""Samples of valves in service on their way to disk, in a thread of their own: what is read waits for no disk."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Final

import numpy as np
import structlog

from drivers.motion.moved_windows import FloatArray, MovedWindows
from drivers.motion.watch_file import MOST_ROWS, WatchDay, WatchFileWriter, day_of, days_in, remove_day
from drivers.watch_rules import WatchRules, WatchSpan
from valve.messages import say

_LOG = structlog.get_logger(__name__)
_MOST_WAITING: Final = 4000  # blocks that the disk has not taken: 100 s of 200 valves
_LEAST_FREE_BYTES: Final = 1_000_000_000  # tests need a fifth of it: they go before
_FREE_KNOWN_S: Final = 30.0

Row = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class WatchedValve:
    """What the samples of a valve are kept by; ``software`` stands in the header of its files."""

    tag: str
    rules: WatchRules
    travel_m: float | None
    software: str


class WatchKeeper:
    """Keeps the windows that moved, a file a valve and day in ``folder``. Belongs to the event loop.

    ``kept`` counts the rows on disk by valve, ``dropped`` those that the disk did not take in time.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="watched")
        self._open: dict[str, _Day] = {}  # the thread's own
        self._waiting = 0
        self._free = _FreeDisk(folder)
        self.kept: dict[str, int] = {}
        self.dropped: dict[str, int] = {}

    def take(self, valve: WatchedValve, span: WatchSpan, rows: Sequence[Row]) -> None:
        """Hand rows of a span on to the thread; returns at once."""
        if not rows:
            return
        if self._waiting >= _MOST_WAITING:
            if not self.dropped:
                _LOG.error("samples in service not kept: the disk does not take them in time", valve=valve.tag)
            self.dropped[valve.tag] = self.dropped.get(valve.tag, 0) + len(rows)
            return
        self._waiting += 1
        taking = asyncio.get_running_loop().run_in_executor(
            self._thread, self._take, valve, span, np.array(rows, dtype=np.float64)
        )
        taking.add_done_callback(self._taken)

    def _taken(self, done: asyncio.Future[None]) -> None:
        self._waiting -= 1
        if not done.cancelled() and (error := done.exception()) is not None:
            _LOG.error("samples in service not kept", exc_info=error)

    async def close(self) -> None:
        """Write what was handed on, and close the files."""
        await asyncio.get_running_loop().run_in_executor(self._thread, self._close)
        self._thread.shutdown(wait=False)

    # ---- in the thread

    def _take(self, valve: WatchedValve, span: WatchSpan, rows: FloatArray) -> None:
        day = self._open.get(valve.tag)
        if day is None or day.span != span or day.valve != valve:
            if day is not None:
                day.close()
            day = self._open[valve.tag] = _Day(self._folder, valve, span)
            self._tidy(valve, span)
        day.take(rows, self._free)
        self.kept[valve.tag] = self.kept.get(valve.tag, 0) + day.fresh()

    def _close(self) -> None:
        for day in self._open.values():
            day.close()
        self._open.clear()

    def _tidy(self, valve: WatchedValve, span: WatchSpan) -> None:
        """Remove the files of a valve that may go: never the newest ``keep_days``, as the clock may be wrong."""
        oldest = span.day - timedelta(days=valve.rules.keep_days)
        try:
            for one in days_in(self._folder, valve.tag)[: -valve.rules.keep_days]:
                if one.day < oldest:  # that of yesterday is judged while that of today is read
                    remove_day(one)
        except OSError as error:
            _LOG.warning("old samples in service not removed", valve=valve.tag, error=str(error))


class _Day:
    """The day of one valve: what moved is written, and what cannot be written is said once."""

    def __init__(self, folder: Path, valve: WatchedValve, span: WatchSpan) -> None:
        self.valve = valve
        self.span = span
        self._place: WatchDay = day_of(folder, valve.tag, span.day)
        self._windows = MovedWindows(valve.travel_m)
        self._writer: WatchFileWriter | None = None
        self._fault = ""
        self._fresh = 0

    def take(self, rows: FloatArray, disk: _FreeDisk) -> None:
        kept = self._windows.take(rows)
        if not len(kept):
            return
        try:
            disk.require()
            if self._writer is None:
                self._writer = self._opened()
            if self._writer.rows + len(kept) > MOST_ROWS:
                raise OSError(
                    say(
                        "watched_day_full",
                        "its file has {count} rows, {most} are the most of a day",
                        count=self._writer.rows,
                        most=MOST_ROWS,
                    )
                )
            self._writer.append(kept)
        except OSError as error:
            if not self._fault:
                self._fault = str(error)
                _LOG.error(
                    "samples in service not kept", valve=self.valve.tag, day=str(self.span.day), error=str(error)
                )
        else:
            self._fresh += len(kept)

    def _opened(self) -> WatchFileWriter:
        header = {
            "period_s": self.valve.rules.period_s,
            "begins": self.span.begins.isoformat(),
            "ends": self.span.ends.isoformat(),
            "software": self.valve.software,
        }
        writer = WatchFileWriter(self._place, header)
        if writer.aside is not None:
            _LOG.error(
                "file of samples in service damaged: it is kept beside the new one, and not judged: look at the disk",
                valve=self.valve.tag,
                day=str(self.span.day),
                kept=writer.aside.name,
            )
        return writer

    def fresh(self) -> int:
        """Return how many rows were written since this was asked last."""
        fresh, self._fresh = self._fresh, 0
        return fresh

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except OSError as error:
                _LOG.error("samples in service not on disk", valve=self.valve.tag, error=str(error))


class _FreeDisk:
    """Whether the disk has room beside what tests need; asked now and then."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._asked_s = -np.inf
        self._free_bytes = 0

    def require(self) -> None:
        """Raise OSError where it has too little."""
        if time.monotonic() - self._asked_s > _FREE_KNOWN_S:
            self._folder.mkdir(parents=True, exist_ok=True)
            seen = os.statvfs(self._folder)
            self._free_bytes, self._asked_s = seen.f_bavail * seen.f_frsize, time.monotonic()
        if self._free_bytes < _LEAST_FREE_BYTES:
            raise OSError(
                say(
                    "disk_left_to_tests",
                    "{free:.2g} GB of the store's disk are free, {left:g} GB are left to tests: free some space",
                    free=self._free_bytes / 1e9,
                    left=_LEAST_FREE_BYTES / 1e9,
                )
            )
