"""A run while it is alive: its state in memory, its stop switch, and what its watchers see."""

from __future__ import annotations

import asyncio
import math
import time
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from drivers.outcome import SampleBlock
from drivers.stands_at import StandsAt
from service.model.run import Run
from service.model.stands_words import where_it_stands
from service.runs.events import EventLog
from service.store.run_table import RunTable

_LIVE_PERIOD_S: Final = 0.05  # 20 points a second are more than an eye follows
_PROGRESS_STEP: Final = 0.005
# Motion is the greater part of a test, 40 to 150 s; the rest is the analysis, about 20 s of a core.
MOTION_SHARE: Final = 0.7
_REMEMBERED_RUNS: Final = 32  # finished runs whose events can still be followed


class LiveRun:
    """One run from its request to its end; changed on the event loop alone."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.stop = asyncio.Event()
        self.stop_reason = ""
        self.stopped_by: set[str] = set()
        self.began_s = time.monotonic()
        #: The valve stands: ``run.safe_confirmed`` says whether it was seen at its safe value. Nothing is stored yet.
        self.at_rest = asyncio.Event()
        self.motion_ended = asyncio.Event()
        self.finished = asyncio.Event()
        self.events = EventLog()
        #: Held by whoever stores a change of the run, from reading it to letting it be seen.
        self.storing = asyncio.Lock()
        self._shown = -1.0
        self._phase = ""
        self._last_point_s = -math.inf
        self.announce()

    def announce(self) -> None:
        """Tell the watchers the state, and at the end that it is the end."""
        run = self.run
        self.events.append("state", {"id": run.id, "state": run.state.value, "progress": run.progress})
        if run.state.finished:
            end = {"id": run.id, "state": run.state.value, "error": run.error, "safe_confirmed": run.safe_confirmed}
            end["stands"] = where_it_stands(run)
            self.events.append("end", end)
            self.events.close()
            self.at_rest.set()
            self.finished.set()

    async def keep_stands(self, runs: RunTable, stands: StandsAt) -> Run:
        """Store where the valve was seen to stand, then let the watchers see it. Raises as the store does."""
        async with self.storing:
            await asyncio.to_thread(runs.note_stands, self.run, stands)
            self.show_stands(stands)
        return self.run

    def show_stands(self, stands: StandsAt) -> None:
        """Let the watchers see where the valve stands."""
        self.run = replace(self.run, stands=stands)
        if not self.events.closed:
            self.events.append("stands", {"verdict": stands.verdict.value, "sentence": where_it_stands(self.run)})

    def progress(self, share: float, phase: str) -> None:
        """Note how much of the whole test is done, 0 to 1."""
        share = min(1.0, max(self.run.progress, share))
        self.run = replace(self.run, progress=share)
        if phase != self._phase or share >= self._shown + _PROGRESS_STEP:
            self._shown, self._phase = share, phase
            self.events.append("progress", {"progress": round(share, 4), "phase": phase})

    def samples(self, block: SampleBlock) -> None:
        """Show what was polled, thinned; what a device captured by itself was watched already."""
        if block.sent_s is None and block.recorded:
            return
        chosen: list[int] = []
        for index, time_s in enumerate(block.time_s.tolist()):
            if not 0.0 <= time_s - self._last_point_s < _LIVE_PERIOD_S:
                chosen.append(index)
                self._last_point_s = time_s
        if chosen:
            names = ("time_s", "position_m", "pressure_pa", "command_pa")
            self.events.append("samples", {name: _numbers(getattr(block, name)[chosen].tolist()) for name in names})

    def request_stop(self, reason: str) -> None:
        """Throw the switch; the first reason counts. It is heard as long as the device is asked, in an upload too."""
        if not self.stop.is_set():
            self.stop_reason = reason
            self.stop.set()


class LiveRuns:
    """The runs of this process that are alive, and the last that ended, whose events can still be followed."""

    def __init__(self) -> None:
        self._runs: OrderedDict[str, LiveRun] = OrderedDict()

    def __iter__(self) -> Iterator[LiveRun]:
        return iter(self._runs.values())

    def find(self, run_id: str) -> LiveRun | None:
        """Return a run; None where it is of another process or long over."""
        return self._runs.get(run_id)

    def forget(self, run_id: str) -> None:
        """Let a run be read from the store from now on."""
        self._runs.pop(run_id, None)

    def begin(self, run: Run) -> LiveRun:
        """Return a stored run as a live one; the oldest that ended are forgotten."""
        live = LiveRun(run)
        self._runs[run.id] = live
        self._runs.move_to_end(run.id)
        finished = [key for key, other in self._runs.items() if other.finished.is_set()]
        for key in finished[: max(0, len(self._runs) - _REMEMBERED_RUNS)]:
            del self._runs[key]
        return live


def _numbers(values: list[float]) -> list[Any]:
    return [value if math.isfinite(value) else None for value in values]
