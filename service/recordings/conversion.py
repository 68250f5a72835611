"""Recordings as CSV, made in another process of lower priority: the event loop and its neighbours keep their time."""

from __future__ import annotations

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from service.workers.priority import stand_back


def _csv(path: Path) -> bytes:
    from valve.recording_csv import csv_bytes  # noqa: PLC0415  - only the other process needs these
    from valve.recording_files import read_recording, recording_columns  # noqa: PLC0415

    return csv_bytes(recording_columns(read_recording(path)))


class Converter:
    """One worker process, started at the first request."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    async def csv(self, path: Path) -> bytes:
        """Return a stored recording as CSV. Raises RecordingError where the file is damaged."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), stand_back)
        return await asyncio.get_running_loop().run_in_executor(self._pool, _csv, path)

    async def close(self) -> None:
        """End the worker."""
        if self._pool is not None:
            await asyncio.to_thread(self._pool.shutdown, cancel_futures=True)
            self._pool = None
