"""The analysis in another process, so that the event loop only moves data."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import structlog

from service.model.watched_day import DayJudged
from service.workers.allowance import Allowance
from service.workers.priority import ANALYSIS
from valve import errors
from valve.errors import InternalError, ValveError
from valve.messages import Message, message_of, restored, say
from valve.nameplate import Nameplate

Progress = Callable[[float, str], None]

WORKER: Final = (sys.executable, "-m", "service.workers.analysis_worker")
_LOG = structlog.get_logger(__name__)
_START_LIMIT_S: Final = 300.0  # compiling everything once on a slow machine
_END_LIMIT_S: Final = 2.0
_LOOK_ONLY: Final = os.WEXITED | os.WNOHANG | os.WNOWAIT
# A second thread of the linear algebra gains nothing on small matrices and takes a core from the polling.
_ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1"}
_LONGEST_ANSWER_BYTES: Final = 2**24
_DIAGNOSIS_LIMIT_S: Final = 150.0  # a diagnosis is counted to take a tenth of it: this ends one that hangs


class _WorkerEndedError(InternalError):
    """The worker ended before it answered."""


class _DiedWaitingError(_WorkerEndedError):
    """The same, with a worker that had been waiting for this job and had not begun to answer."""


class AnalysisProcess:
    """One worker process that analyses one recording after the other.

    ``start`` begins to load and compile at once; ``analyze`` waits for it. A worker that crashes or takes longer
    than ``time_limit_s`` fails its job with InternalError and is replaced at the next one. Where that happens after
    the estimates, or the diagnosis takes longer than ``diagnosis_limit_s``, the answer is the estimates alone. Both
    count the worker's processor time.
    ``command`` starts a process that speaks as ``analysis_worker`` does, ``niceness`` below the service;
    ``most_rows`` and ``most_memory_bytes`` bound what the recordings of a job may take in all.
    """

    def __init__(
        self,
        *,
        time_limit_s: float = 300.0,
        diagnosis_limit_s: float = _DIAGNOSIS_LIMIT_S,
        command: Sequence[str] = WORKER,
        niceness: int = ANALYSIS,
        most_rows: int | None = None,
        most_memory_bytes: int | None = None,
    ) -> None:
        self._time_limit_s = time_limit_s
        self._diagnosis_limit_s = diagnosis_limit_s
        self._command = tuple(command)
        self._niceness = niceness
        self._bounds = {"most_rows": most_rows, "most_memory_bytes": most_memory_bytes}
        self._turn = asyncio.Lock()
        self._reading = asyncio.Lock()  # of a worker's answers: of two readers asyncio loses one
        self._worker: Process | None = None
        self._ready = False
        self._closed = False

    async def start(self) -> None:
        """Start the worker; it warms up while the caller goes on."""
        async with self._turn:
            await self._started()

    async def warm(self) -> None:
        """Return when the worker is ready for a job, started where there is none. Raises InternalError."""
        async with self._turn:
            await self._readied(await self._started())

    async def rest(self) -> None:
        """End the worker behind the jobs that wait; a later job starts it anew."""
        async with self._turn:
            await self._discard()

    async def close(self) -> None:
        """End the worker, also in the middle of a job; nothing is left behind and no job is taken any more."""
        self._closed = True
        await self._discard()

    async def __aenter__(self) -> AnalysisProcess:
        """Start, as ``start`` does."""
        await self.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close, as ``close`` does."""
        await self.close()

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker, None while there is none."""
        return None if self._worker is None else self._worker.pid

    async def analyze(
        self,
        recording_path: Path | str,
        nameplate: Nameplate,
        progress: Progress | None = None,
        *,
        together: Sequence[Path | str] = (),
        held_out: Sequence[tuple[str, Path | str]] = (),
        accepted: Mapping[str, Any] | None = None,
        room: Mapping[str, float] | None = None,
        mapping: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Return the analysis object of a recording file; ``together``: others of the same valve, analysed with it.

        ``held_out`` are the names and files of recordings that are not fitted, ``accepted`` is
        the valve's extended model where one was accepted, ``room`` what a further test may use. ``mapping``, also an
        empty one, says that the files are as their owners have them, and what their headers leave open.

        Raises what reading and analysing it raise, and InternalError where the worker crashed or took too long.
        Cancelling ends the worker.
        """
        job = {
            "recordings": [str(path) for path in (recording_path, *together)],
            "held_out": [[name, str(path)] for name, path in held_out],
            "nameplate": asdict(nameplate),
            "accepted": None if accepted is None else dict(accepted),
            "room": None if room is None else dict(room),
            **self._bounds,
            "mapping": None if mapping is None else dict(mapping),
        }
        async with self._turn:
            try:
                answer = await self._attempt(job, progress)
            except _DiedWaitingError:  # it may have ended before this job: a fresh one says whether the job does it
                answer = await self._attempt(job, progress)
        if "error" in answer:
            raise _error(answer)
        return restored(answer["analysis"])

    async def judge_day(self, path: Path, nameplate: Nameplate) -> DayJudged:
        """Return what a day of a valve in service says. Raises RecordingError, InternalError as ``analyze`` does."""
        async with self._turn:
            answer = await self._attempt({"watched": str(path), "nameplate": asdict(nameplate)}, None)
        if "error" in answer:
            raise _error(answer)
        return DayJudged.from_json(restored(answer["analysis"]))

    async def _discard(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            await _ended(worker, self._reading)

    async def _attempt(self, job: dict[str, Any], progress: Progress | None) -> dict[str, Any]:
        worker, answered = await self._started(), False
        try:
            answer = await self._answer(worker, job, progress)
            answered = True
        finally:
            if not answered:  # crashed, too slow or cancelled: a late answer must not become the next job's
                await self._discard()
        return answer

    async def _started(self) -> Process:
        if self._closed:
            raise InternalError(
                say("analysis_closed", "analysis: it was closed, as the service is ending: repeat the request later")
            )
        if self._worker is not None and _alive(self._worker):
            return self._worker
        await self._discard()
        self._ready = False
        self._worker = await asyncio.create_subprocess_exec(
            *self._command, stdin=PIPE, stdout=PIPE, limit=_LONGEST_ANSWER_BYTES, env=os.environ | _ONE_THREAD
        )
        with suppress(ProcessLookupError):  # by its owner: loading its libraries alone takes seconds of a core
            own = os.getpriority(os.PRIO_PROCESS, 0)
            os.setpriority(os.PRIO_PROCESS, self._worker.pid, own + self._niceness)  # the system takes 19 for more
        _LOG.info("analysis worker started", pid=self._worker.pid)
        return self._worker

    async def _readied(self, worker: Process) -> None:
        if not self._ready:
            await self._next(worker, [Allowance(worker.pid, _START_LIMIT_S)], "start")
            self._ready = True

    async def _answer(self, worker: Process, job: dict[str, Any], progress: Progress | None) -> dict[str, Any]:
        waited = self._ready
        if not waited:
            if progress is not None:
                progress(0.0, say("analysis_getting_ready", "getting the analysis ready"))
            await self._readied(worker)
        assert worker.stdin is not None
        with suppress(ConnectionError):  # a worker that died shows when its answer is read
            worker.stdin.write(json.dumps(job).encode() + b"\n")
            await worker.stdin.drain()
        allowances = [Allowance(worker.pid, self._time_limit_s)]
        estimated: dict[str, Any] | None = None
        while True:
            try:
                answer = await self._next(worker, allowances, "analyse")
            except _WorkerEndedError as error:
                if waited:
                    raise _DiedWaitingError(message_of(error)) from error
                if estimated is None or self._closed:
                    raise
                return await self._undiagnosed(estimated, say("diagnosis_process_ended", "its process ended"))
            except InternalError:
                if estimated is None:
                    raise
                return await self._undiagnosed(estimated, say("diagnosis_too_long", "it took too long"))
            waited = False
            if "estimated" in answer:
                estimated = restored(answer["estimated"])
                allowances.append(Allowance(worker.pid, self._diagnosis_limit_s))
                continue
            if "progress" not in answer:
                return answer
            if progress is not None:
                progress(float(answer["progress"]), restored(answer)["phase"])

    async def _undiagnosed(self, estimated: dict[str, Any], reason: Message) -> dict[str, Any]:
        """Return the estimates alone, and end the worker."""
        _LOG.error("diagnosis ended early", reason=str(reason))
        await self._discard()
        message = say(
            "diagnosis_ended_early",
            "The diagnosis failed ({reason}): the estimates stand; report it with the recording.",
            reason=reason,
        )
        return {"analysis": {**estimated, "discrepancy": {**estimated["discrepancy"], "message": message}}}

    def _too_long(self, what: str) -> Message:
        if what == "start":
            return say(
                "analysis_not_ready",
                "analysis: the worker was not ready within {limit:g s}: look at the log and report it",
                limit=_START_LIMIT_S,
            )
        return say(
            "analysis_too_long",
            "analysis: the worker took more than {limit:g s} and was ended: shorten the recording, or report it",
            limit=self._time_limit_s,
        )

    async def _next(self, worker: Process, allowances: Sequence[Allowance], what: str) -> dict[str, Any]:
        assert worker.stdout is not None
        line = None
        while line is None:
            left_s = min(one.left_s() for one in allowances)
            if left_s <= 0.0:
                raise InternalError(self._too_long(what))
            with suppress(TimeoutError):
                async with asyncio.timeout(left_s), self._reading:
                    line = await worker.stdout.readline()
        if not line.endswith(b"\n"):
            with suppress(TimeoutError):
                async with asyncio.timeout(_END_LIMIT_S):
                    await worker.wait()
            raise _WorkerEndedError(
                say(
                    "analysis_worker_ended",
                    "analysis: the worker ended with code {status} before it answered: its last words are in the log; "
                    "repeat the request, and report it if it ends again",
                    status=str(worker.returncode),
                )
            )
        return dict(json.loads(line))


def _alive(worker: Process) -> bool:
    """Whether it runs, asked of the system: the event loop hears of an end a moment later."""
    try:
        return worker.returncode is None and os.waitid(os.P_PID, worker.pid, _LOOK_ONLY) is None
    except ChildProcessError:  # reaped, and about to be told
        return False


async def _ended(worker: Process, reading: asyncio.Lock) -> None:
    """Kill the worker, which holds nothing that needs saving, and take away all that is left of it.

    ``reading`` is held by the job that is being ended until it has read the end.
    """
    with suppress(ProcessLookupError):
        worker.kill()
    if worker.stdin is not None:
        worker.stdin.close()
        with suppress(ConnectionError):
            await worker.stdin.wait_closed()
    if worker.stdout is not None:
        async with reading:
            await worker.stdout.read()  # to its end, so that the pipe is closed with the process
    await worker.wait()


def _error(answer: dict[str, Any]) -> ValveError:
    """Return the worker's error as the same class; the tree of errors is closed, so a name is enough."""
    kind = getattr(errors, str(answer["error"]), InternalError)
    error: ValveError = kind(restored(answer)["message"])
    return error
