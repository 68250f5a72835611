"""Re-analyses: stored tests of a time analysed anew, oldest first, behind everything else.

The rows of ``reanalysed_tests`` say what is to be done and what was; the queue of durable jobs carries a re-analysis as
one job. What a dead process had taken up is looked at first: its analysis was stored, is taken up by the start of the
service, or was never begun and is queued again.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable
from concurrent.futures import CancelledError, Future
from datetime import UTC, datetime
from functools import partial
from typing import Final

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.motion.audit_log import AuditLog
from service.config.plant import Plant
from service.model.analysis import ANALYSIS_FAILED, ENGINE
from service.model.reanalysis import (
    Found,
    Reanalysis,
    ReanalysisProgress,
    ReanalysisState,
    Repeat,
    RepeatState,
    Wanted,
)
from service.model.requester import Requester
from service.model.run import Run, RunState
from service.runs.service import Runs
from service.store.store import Store
from valve.errors import BusyError, NotFoundError, RequestError, ValveError
from valve.messages import message_of, say

_LOG = structlog.get_logger(__name__)
_WAIT_S: Final = 30.0
_AGAIN_S: Final = 5.0  # a database that is away comes back

#: Puts a re-analysis into the queue: the id of the job, and its number.
Enqueue = Callable[[str, int], Awaitable[None]]


class Reanalyses:
    """The re-analyses of one gateway, ``at_once`` tests at a time; all methods belong to the event loop but one."""

    def __init__(
        self, plant: Plant, store: Store, runs: Runs, *, software: str, audit: AuditLog | None = None, at_once: int = 1
    ) -> None:
        self._plant = plant
        self._table = store.reanalyses
        self._runs = runs
        self._software = software
        self._audit = audit
        self._at_once = at_once
        self._gateway = plant.service.gateway
        self._process = secrets.token_hex(8)
        self._enqueue: Enqueue | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = asyncio.Event()
        self._asking = asyncio.Lock()
        self._turn = asyncio.Lock()
        self._carried: set[Future[str]] = set()
        self._find = partial(store.reanalyses.find, failed=ANALYSIS_FAILED, engine=ENGINE)
        self._insert = partial(store.reanalyses.insert, failed=ANALYSIS_FAILED, engine=ENGINE)

    async def start(self, enqueue: Enqueue) -> None:
        """Queue again what has not ended."""
        self._loop = asyncio.get_running_loop()
        self._enqueue = enqueue
        for left in await asyncio.to_thread(self._table.unfinished, self._gateway):
            await self._queue(left)

    async def _queue(self, reanalysis: Reanalysis) -> None:
        assert self._enqueue is not None, "start comes first"
        # Another process's job of it finds it done, or waits for this one and finds it done then.
        await self._enqueue(f"reanalysis {reanalysis.id}:{self._process}", reanalysis.id)

    def stop_waiting(self) -> None:
        """Take up no further test."""
        self._closing.set()

    async def close(self) -> None:
        """Return when no test of a re-analysis is waited for any more. The runs must have ended."""
        self.stop_waiting()
        if self._carried:
            await asyncio.wait([asyncio.wrap_future(one) for one in tuple(self._carried)], timeout=_AGAIN_S)

    async def find(self, wanted: Wanted) -> Found:
        """Return what a request would find. Raises RequestError and NotFoundError where it makes no sense here."""
        now = datetime.now(UTC)
        if wanted.valve is not None:
            self._runs.valve(wanted.valve)
        if wanted.since > now:
            raise RequestError(
                say(
                    "since_in_future",
                    "since {since} is in the future (it is {now}): give an earlier date",
                    since=wanted.since,
                    now=now,
                )
            )
        if wanted.until is not None and wanted.until <= wanted.since:
            raise RequestError(
                say(
                    "until_not_after_since",
                    "until {until} is not after since {since}: give a later until",
                    until=wanted.until,
                    since=wanted.since,
                )
            )
        return await asyncio.to_thread(self._find, wanted, self._gateway)

    async def ask(self, wanted: Wanted, requester: Requester) -> ReanalysisProgress:
        """Queue a re-analysis, or return the one that was asked for in the same words and has not ended.

        Raises RequestError, NotFoundError where there is nothing to analyse, BusyError where all of it is queued.
        """
        async with self._asking:
            found = await self.find(wanted)
            for other in await asyncio.to_thread(self._table.unfinished, self._gateway):
                if other.wanted == wanted and other.stopped_by is None:
                    return await self.progress(other.id)
            if found.here == 0:
                raise self._nothing(wanted, found)
            if self._closing.is_set():
                raise BusyError(
                    say("shutting_down", "the service is shutting down: repeat the request when it is back")
                )
            asked = Reanalysis(wanted, self._gateway, self._software, requester.name, datetime.now(UTC))
            if self._audit is not None:
                told = {
                    "since": wanted.since.isoformat(),
                    "until": None if wanted.until is None else wanted.until.isoformat(),
                    "tests": found.here,
                }
                note = partial(self._audit.append, "analyses.repeated", valve=wanted.valve or "", details=told)
                await asyncio.to_thread(note, who=requester.name)
            stored = await asyncio.to_thread(self._insert, asked)
            await self._queue(stored)
        _LOG.info("re-analysis asked for", reanalysis=stored.id, tests=found.here, by=requester.name)
        return await self.progress(stored.id)

    def _nothing(self, wanted: Wanted, found: Found) -> ValveError:
        """Return why there is nothing to analyse."""
        valve = wanted.valve or say("any_valve", "any valve")
        meant = say("no_test_since", "{valve}: no test since {since}", valve=valve, since=wanted.since)
        if wanted.until is not None:
            meant = say(
                "no_test_between",
                "{valve}: no test since {since} and before {until}",
                valve=valve,
                since=wanted.since,
                until=wanted.until,
            )
        if found.queued_already:
            return BusyError(
                say(
                    "all_queued",
                    "{valve}: {n} tests of that time are queued by another re-analysis and none is left: GET "
                    "/reanalyses shows how far it is",
                    valve=valve,
                    n=found.queued_already,
                )
            )
        if found.elsewhere:
            names = tuple(name or say("no_gateway", "(no gateway)") for name in sorted(found.elsewhere))
            return NotFoundError(
                say(
                    "recordings_elsewhere",
                    "{meant} has its recording here; {gateways:, } made them: ask there, by --url",
                    meant=meant,
                    gateways=names,
                )
            )
        if found.without_recording:
            return NotFoundError(
                say(
                    "recordings_removed",
                    "{meant} still has its recording ({n} were removed by service.retention): give a later since",
                    meant=meant,
                    n=found.without_recording,
                )
            )
        if wanted.older_only:
            meant = say("that_earlier_engine_analysed", "{meant} that an earlier engine analysed", meant=meant)
        return NotFoundError(
            say(
                "no_motion_that_ended_well",
                "{meant} has a recording of a motion that ended well: give an earlier since",
                meant=meant,
            )
        )

    async def progress(self, number: int) -> ReanalysisProgress:
        """Return how far a re-analysis is. Raises NotFoundError."""
        return await asyncio.to_thread(lambda: self._table.progress(self._table.get(number)))

    async def newest(self, limit: int) -> list[ReanalysisProgress]:
        """Return the newest re-analyses, of all gateways of this database, newest first."""
        return await asyncio.to_thread(lambda: [self._table.progress(one) for one in self._table.newest(limit)])

    async def stop(self, number: int, requester: Requester) -> ReanalysisProgress:
        """Take what is queued out of a re-analysis; the tests under way end, new results stay. Raises NotFoundError."""
        before = await self.progress(number)
        if before.state in (ReanalysisState.QUEUED, ReanalysisState.RUNNING):
            now = datetime.now(UTC)
            if await asyncio.to_thread(self._table.stop, number, requester.name, now):
                await asyncio.to_thread(self._table.end, number, now)
                _LOG.warning("re-analysis stopped", reanalysis=number, by=requester.name)
        return await self.progress(number)

    def carry_out_in_thread(self, number: int) -> str:
        """Carry a re-analysis out from a thread of the queue; return how it stands then."""
        if self._loop is None or self._closing.is_set():
            return ReanalysisState.QUEUED.value
        carried = asyncio.run_coroutine_threadsafe(self.carry_out(number), self._loop)
        self._carried.add(carried)
        try:
            return carried.result()
        except CancelledError:
            return ReanalysisState.RUNNING.value
        finally:
            self._carried.discard(carried)

    async def carry_out(self, number: int) -> str:
        """Analyse what is queued of a re-analysis until nothing is; return how it stands then."""
        async with self._turn:
            reanalysis = await asyncio.to_thread(self._table.get, number)
            while reanalysis.ended_at is None and not self._closing.is_set():
                try:
                    await self._work(number, reanalysis.requested_by)
                    await asyncio.to_thread(self._table.end, number, datetime.now(UTC))
                    reanalysis = await asyncio.to_thread(self._table.get, number)
                except (SQLAlchemyError, OSError) as error:
                    _LOG.warning("re-analysis waits", reanalysis=number, reason=str(error))
                    await self._pause(_AGAIN_S)
        return (await self.progress(number)).state.value

    async def _work(self, number: int, by: str) -> None:
        """Take up one test after the other, never two of a valve: each is compared with the results before it."""
        under_way = {
            asyncio.create_task(self._take_on(one)): one.valve
            for one in await asyncio.to_thread(self._table.running, number)
        }
        try:
            while not self._closing.is_set():
                taken = None
                if len(under_way) < self._at_once:
                    without = list(under_way.values())
                    take_up = partial(self._table.take_up, number, self._process, datetime.now(UTC), without=without)
                    taken = await asyncio.to_thread(take_up)
                if taken is not None:
                    under_way[asyncio.create_task(self._analyze(taken, by))] = taken.valve
                elif under_way:
                    done, _ = await asyncio.wait(under_way, return_when=asyncio.FIRST_COMPLETED)
                    for task in done:
                        del under_way[task]
                        await task
                else:
                    return
            await asyncio.gather(*under_way)
        finally:
            for task in under_way:
                task.cancel()

    async def _take_on(self, repeat: Repeat) -> None:
        """Bring a test to its end that a dead process had taken up."""
        try:
            run = await self._runs.get(repeat.test_id)
        except NotFoundError as error:
            await self._end(repeat, RepeatState.SKIPPED, message_of(error))
            return
        begun_at = repeat.begun_at
        is_over = run.finished_at is not None and begun_at is not None and run.finished_at >= begun_at
        if run.state is RunState.ANALYZING or is_over:
            await self._follow(repeat, run)
        else:
            await asyncio.to_thread(self._table.put_back, repeat)

    async def _analyze(self, repeat: Repeat, by: str) -> None:
        """Have one test analysed and write down what came of it."""
        while not self._closing.is_set():
            try:
                run = await self._runs.analyze_behind(repeat.test_id, by)
            except BusyError:  # somebody else has it analysed just now, or the service ends
                await self._runs.wait(repeat.test_id, _WAIT_S)
                await self._pause(0.1)
            except ValveError as error:
                await self._end(repeat, RepeatState.SKIPPED, message_of(error))
                return
            else:
                await self._follow(repeat, run)
                return
        await asyncio.to_thread(self._table.put_back, repeat)

    async def _follow(self, repeat: Repeat, run: Run) -> None:
        while not run.state.finished:
            if self._closing.is_set():
                return  # the next start takes the analysis up
            run = await self._runs.wait(run.id, 1.0)
        good = run.state is RunState.COMPLETED and not run.error
        await self._end(repeat, RepeatState.COMPLETED if good else RepeatState.FAILED, run.error)

    async def _end(self, repeat: Repeat, state: RepeatState, reason: str) -> None:
        await asyncio.to_thread(self._table.end_test, repeat, state, reason, datetime.now(UTC))

    async def _pause(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._closing.wait()
        except TimeoutError:
            return
