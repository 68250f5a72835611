"""Several analysis workers, so that tests which end together are not analysed one after the other."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

from service.model.refusals import ThrottledError
from service.model.watched_day import DayJudged
from service.workers.analysis_process import WORKER, AnalysisProcess
from service.workers.polling import Polling
from service.workers.priority import UPLOAD
from valve.errors import InternalError
from valve.messages import say
from valve.nameplate import Nameplate

_MOST_WORKERS: Final = 4  # each holds about 300 MB
MOST_UPLOADS: Final = 8  # at once, those that wait included
MOST_UPLOADED_ROWS: Final = 2_000_000  # of all files of one upload: half an hour of 1 kHz
_MOST_UPLOAD_MEMORY_BYTES: Final = 4_000_000_000
WARM_AFTER_S: Final = 15.0  # a job that comes earlier starts its worker itself
_REST_AFTER_S: Final = 60.0
_UPLOAD_AGAIN_S: Final = 60.0  # an analysis takes about 20 s of a core


class WorkerPool:
    """As many workers as there are cores, at most four; they start one after the other, a while after the pool.

    First of all a service that has just started reads where its valves stand. What a worker loads, while valves move,
    makes their samples late, and the others find compiled what the first one compiled. They run at a lower priority
    than the service, so a core that polls is not held up by them. While a valve is polled no job begins that would
    leave it less than a core of its own, where there are two; one always may.

    Uploads have a worker of their own, of the lowest priority, and begin one at a time, when no test waits for its
    analysis and a core is free. So have analyses that are repeated for nobody who waits: as many as leave a core, each
    worker started when it is first needed and ended some time after the last.
    """

    def __init__(
        self,
        workers: int | None = None,
        *,
        command: Sequence[str] = WORKER,
        polling: Polling | None = None,
        cores: int | None = None,
        warm_after_s: float = WARM_AFTER_S,
    ) -> None:
        self._warm_after_s = warm_after_s
        self._cores = cores or os.cpu_count() or 1
        count = workers if workers is not None else min(self._cores, _MOST_WORKERS)
        self._members = [AnalysisProcess(command=command) for _ in range(count)]
        self._jobs = [0] * count
        self._tests_waiting = 0
        self._uploads = AnalysisProcess(
            command=command, niceness=UPLOAD, most_rows=MOST_UPLOADED_ROWS, most_memory_bytes=_MOST_UPLOAD_MEMORY_BYTES
        )
        self._behind = [AnalysisProcess(command=command, niceness=UPLOAD) for _ in range(max(1, count - 1))]
        self._idle_behind = list(self._behind)
        self._resting: asyncio.Task[None] | None = None
        self._upload_turn = asyncio.Lock()
        self._uploads_asked = 0
        self._polling = polling or Polling()
        self._closed = False
        self._warming: asyncio.Task[None] | None = None

    @property
    def worker_pids(self) -> list[int | None]:
        """Process id of each worker, None where it has not started yet."""
        return [member.worker_pid for member in self._members]

    @property
    def most_behind(self) -> int:
        """How many analyses ``behind`` all others go on at once."""
        return len(self._behind)

    def start(self) -> None:
        """Let the workers start and warm up, one after the other, while the caller goes on."""
        self._warming = asyncio.create_task(self._warm())

    async def _warm(self) -> None:
        await asyncio.sleep(self._warm_after_s)
        for member in self._members:
            # The event loop waits until a new process has its program, which on a busy machine takes a while.
            while self._polling.goes_on and not self._closed:
                await self._polling.change()
            with suppress(InternalError):  # the log has its last words; a job starts it anew and says why it cannot
                await member.warm()

    async def analyze(
        self,
        recording_path: Path | str,
        nameplate: Nameplate,
        progress: Callable[[float, str], None] | None = None,
        *,
        together: Sequence[Path | str] = (),
        held_out: Sequence[tuple[str, Path | str]] = (),
        accepted: Mapping[str, Any] | None = None,
        room: Mapping[str, float] | None = None,
        upload: bool = False,
        behind: bool = False,
        mapping: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Return the analysis object, made by the first worker that is free; else as ``AnalysisProcess.analyze``.

        An ``upload``, and what is ``behind``, waits for real tests. Raises ThrottledError where too many uploads wait
        already.
        """
        place = self._upload_slot() if upload else self._slot_behind() if behind else self._free_member()
        async with place as member:
            return await member.analyze(
                recording_path,
                nameplate,
                progress,
                together=together,
                held_out=held_out,
                accepted=accepted,
                room=room,
                mapping=mapping,
            )

    async def judge_day(self, path: Path, nameplate: Nameplate) -> DayJudged:
        """Return what a day of a valve in service says, behind everything else; as ``AnalysisProcess.judge_day``."""
        async with self._slot_behind() as member:
            return await member.judge_day(path, nameplate)

    @asynccontextmanager
    async def _free_member(self) -> AsyncIterator[AnalysisProcess]:
        """Wait for a worker, and for a core that no valve needs; one that was closed is free and refuses its job."""
        self._tests_waiting += 1
        try:
            while sum(self._jobs) >= self._places and not self._closed:
                await self._polling.change()
        finally:
            self._tests_waiting -= 1
        chosen = min(range(len(self._members)), key=self._jobs.__getitem__)
        self._jobs[chosen] += 1
        try:
            yield self._members[chosen]
        finally:
            self._jobs[chosen] -= 1
            self._polling.tell()

    @asynccontextmanager
    async def _upload_slot(self) -> AsyncIterator[AnalysisProcess]:
        if self._uploads_asked >= MOST_UPLOADS:
            raise ThrottledError(
                say(
                    "uploads_wait",
                    "{count} uploads wait for their analysis, the most is {most}: try again later, or use breakaway "
                    "analyze on a machine of your own",
                    count=self._uploads_asked,
                    most=MOST_UPLOADS,
                ),
                _UPLOAD_AGAIN_S,
            )
        self._uploads_asked += 1
        try:
            async with self._upload_turn:
                while (self._tests_waiting or sum(self._jobs) >= self._places) and not self._closed:
                    await self._polling.change()
                yield self._uploads
        finally:
            self._uploads_asked -= 1

    @asynccontextmanager
    async def _slot_behind(self) -> AsyncIterator[AnalysisProcess]:
        """Wait until no test waits, and for a core that neither a valve nor another analysis needs."""
        while not self._closed and (self._tests_waiting or self._busy >= self._places or not self._idle_behind):
            await self._polling.change()
        chosen = self._idle_behind.pop() if self._idle_behind else self._behind[0]
        try:
            yield chosen
        finally:
            self._idle_behind.append(chosen)
            self._polling.tell()
            if self._resting is not None:
                self._resting.cancel()
            self._resting = asyncio.create_task(self._rest())

    async def _rest(self) -> None:
        """End the workers behind all others once nobody has needed one for a while."""
        await asyncio.sleep(_REST_AFTER_S)
        for member in tuple(self._idle_behind):
            await member.rest()

    @property
    def _busy(self) -> int:
        return sum(self._jobs) + len(self._behind) - len(self._idle_behind)

    @property
    def _places(self) -> int:
        """How many jobs may be under way now."""
        count = len(self._members)
        return min(count, max(1, self._cores - 1)) if self._polling.goes_on else count

    async def close(self) -> None:
        """End every worker, also in the middle of a job."""
        self._closed = True
        self._polling.tell()
        if self._warming is not None:
            self._warming.cancel()
            await asyncio.gather(self._warming, return_exceptions=True)
        if self._resting is not None:
            self._resting.cancel()
            await asyncio.gather(self._resting, return_exceptions=True)
        await asyncio.gather(*(member.close() for member in (*self._members, *self._behind, self._uploads)))
