"""The last part of a test: its stored recording becomes its result. Nothing moves here."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import structlog

from service.runs.analyst import Analyst, assessed
from service.runs.live import MOTION_SHARE, LiveRun
from service.runs.run import RunState
from service.settings import PlantValve
from service.store.store import Store
from valve.errors import ValveError

_LOG = structlog.get_logger(__name__)


class Conclusion:
    """Stores what becomes of one run, and analyses its recording where there is one."""

    def __init__(self, live: LiveRun, store: Store) -> None:
        self._live = live
        self._store = store

    async def change(self, **changes: Any) -> None:
        """Store the changed run, then let it be seen: nobody hears of what a crash could undo."""
        changed = replace(self._live.run, **changes)
        await asyncio.to_thread(self._store.runs.save, changed)
        self._live.run = changed
        self._live.announce()

    async def end(self, state: RunState, error: str = "", **changes: Any) -> None:
        """Store how the test ended."""
        await self.change(**{"state": state, "error": error, "finished_at": datetime.now(UTC), **changes})
        _LOG.info("test ended", test=self._live.run.id, valve=self._live.run.valve, state=state.value, error=error)

    async def analyze(self, analyst: Analyst, valve: PlantValve, sequence: str, together: Sequence[str]) -> None:
        """Analyse the run's recording and those of the tests ``together``, and store the result or why there is none.

        ``sequence`` is what was played.
        """
        self._on_progress(0.0, "analyzing")
        try:
            analysis = await assessed(
                analyst, self._live.run, valve, sequence, self._store, together=together, progress=self._on_progress
            )
        except ValveError as error:
            await self.end(RunState.FAILED, f"the recording is stored, its analysis failed: {error}")
        else:
            await self.end(RunState.COMPLETED, analysis=analysis, progress=1.0)

    def _on_progress(self, share: float, phase: str) -> None:
        self._live.progress(MOTION_SHARE + (1.0 - MOTION_SHARE) * share, phase)
