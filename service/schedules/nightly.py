"""The night: at its time each schedule's checks are queued, each waits for its turn on its bus, and is written down.

The rows of ``schedule_runs`` say what is to be done and what was; the queue (``jobs``) carries them. Nothing that was
begun is resumed after a crash: it is written down as interrupted, and its valve was sent to safe by the recovery of its
test. What was still queued goes on while its window lasts.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError, Future
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final, Protocol

import structlog

from drivers.motion.orders import MotionLostError
from service.config.plant import Plant
from service.model.check import Check, CheckState
from service.model.family_rule import event_of_early
from service.model.requester import Requester, RequesterKind
from service.model.run import Run, RunState
from service.model.schedule import Occurrence, Schedule, next_occurrence, occurrences_between
from service.model.until import early_words
from service.runs.service import Runs
from service.store.store import Store
from valve.errors import BusyError, NotFoundError, PermissiveError, ValveError
from valve.messages import message_of, say

_LOG = structlog.get_logger(__name__)
_LOOK_S: Final = 30.0  # the wall clock may be set: it is looked at this often, whatever is due
_CUT_OFF: Final[str] = say("check_cut_off", "the service ended while this check was under way: nothing is resumed")
_TURN_S: Final = 0.1
_END_S: Final = 5.0
_LOOK_BACK: Final = timedelta(days=7)  # of checks that were missed while no service ran
_FEWEST_FOLLOWED: Final = 8  # recordings that may wait for their analysis before the next test waits for them

_BY_TEST: Final = {
    RunState.COMPLETED: CheckState.COMPLETED,
    RunState.INTERRUPTED: CheckState.INTERRUPTED,
}


class Queue(Protocol):
    """What carries checks from their time to their turn."""

    def enqueue(self, job_id: str, bus: str, check_id: int) -> None:
        """Put a check into the queue of its bus. May block."""


def wall_clock() -> datetime:
    """Return the present instant."""
    return datetime.now(UTC)


class Nightly:
    """The schedules of one gateway. All methods belong to the event loop but ``carry_out_in_thread``."""

    def __init__(self, plant: Plant, store: Store, runs: Runs, clock: Callable[[], datetime] = wall_clock) -> None:
        self._plant = plant
        self._table = store.schedule_runs
        self._known = store.runs
        self._runs = runs
        self._clock = clock
        self._gateway = plant.service.gateway
        self._process = secrets.token_hex(8)
        self._queue: Queue | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._carried: set[Future[str]] = set()
        self._closing = asyncio.Event()
        self._wake = asyncio.Event()
        self._looking = asyncio.Lock()  # two looks at once would queue the checks of one occurrence out of their order
        self._handled: dict[str, datetime] = {}
        self._known_schedules: dict[str, Schedule] = {}

    async def prepare(self) -> None:
        """Write down what a dead process left. To be called after the recovery of tests and before ``start``."""
        self._loop = asyncio.get_running_loop()
        now = self._clock()
        for check in await asyncio.to_thread(self._table.in_states, self._gateway, [CheckState.RUNNING]):
            await self._note_cut_off(check)
        for schedule in self._plant.schedules:
            newest = await asyncio.to_thread(self._table.newest_due, schedule.name, self._gateway)
            self._handled[schedule.name] = now if newest is None else min(now, max(newest, now - _LOOK_BACK))
        self._known_schedules = {schedule.name: schedule for schedule in self._plant.schedules}

    async def start(self, queue: Queue) -> None:
        """Queue again what was queued, and watch the clock from now on."""
        self._queue = queue
        for check in await asyncio.to_thread(self._table.in_states, self._gateway, [CheckState.QUEUED]):
            await self._enqueue(check)
        self._spawn(self._watch_clock())

    def stop_waiting(self) -> None:
        """Let no further check begin; those whose test runs end with it. What waits stays queued."""
        self._closing.set()
        self._wake.set()

    async def close(self) -> None:
        """End the watch, and wait for what is being written down. The runs must have ended.

        What cannot be written down now is by the next start, as after a crash.
        """
        self.stop_waiting()
        waited = {*self._tasks, *(asyncio.wrap_future(one) for one in tuple(self._carried))}
        if waited:
            _, late = await asyncio.wait(waited, timeout=_END_S)
            for task in late:
                task.cancel()

    def look_now(self) -> None:
        """Look at the clock at once: for tests that set it."""
        self._wake.set()

    def schedules_changed(self) -> None:
        """Go by the schedules that the plant has now; one that is new or has another time counts from now on."""
        now, known = self._clock(), self._known_schedules
        for schedule in self._plant.schedules:
            was = known.get(schedule.name)
            if was is None or (was.cron, was.zone) != (schedule.cron, schedule.zone):
                self._handled[schedule.name] = now
        self._known_schedules = {schedule.name: schedule for schedule in self._plant.schedules}
        self._wake.set()

    async def run_now(self, name: str, requested_by: str) -> list[Check]:
        """Queue a schedule's checks at once. Raises NotFoundError."""
        schedule = self.schedule(name)
        now = self._clock()
        hand = Occurrence(f"{now.astimezone(schedule.zone):%Y-%m-%dT%H:%M:%S} by hand"[:32], now)
        return await self._dispatch(schedule, hand, requested_by)

    def schedule(self, name: str) -> Schedule:
        """Return the schedule of this name. Raises NotFoundError."""
        for schedule in self._plant.schedules:
            if schedule.name == name:
                return schedule
        raise NotFoundError(
            say("schedule_unknown", "schedule {name} is unknown: GET /schedules lists all", name=repr(name[:64]))
        )

    def _spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _watch_clock(self) -> None:
        while not self._closing.is_set():
            self._wake.clear()
            try:
                await self.look()
            except Exception as error:  # noqa: BLE001  - a database that is away for a minute must not end the nights
                _LOG.error("schedules not looked at", exc_info=error)
            with contextlib.suppress(TimeoutError):
                if not self._closing.is_set():
                    await asyncio.wait_for(self._wake.wait(), self._pause_s())

    def _pause_s(self) -> float:
        now = self._clock()
        coming = [next_occurrence(schedule, now) for schedule in self._plant.schedules]
        waits = [(one.due_at - now).total_seconds() for one in coming if one is not None]
        return max(0.0, min([_LOOK_S, *waits]))

    async def look(self) -> None:
        """Queue what has become due since the last look, and write down what was missed."""
        async with self._looking:
            now = self._clock()
            for schedule in self._plant.schedules:
                for occurrence in occurrences_between(schedule, self._handled[schedule.name], now):
                    missed = now > occurrence.due_at + timedelta(seconds=schedule.window_s)
                    await self._dispatch(schedule, occurrence, missed=missed)
                    self._handled[schedule.name] = occurrence.due_at

    async def _dispatch(
        self, schedule: Schedule, occurrence: Occurrence, requested_by: str = "", *, missed: bool = False
    ) -> list[Check]:
        checks = []
        for tag in schedule.valves:
            if not self._plant.is_ours(tag):
                continue
            check = Check(
                schedule.name,
                occurrence.name,
                tag,
                occurrence.due_at,
                schedule.window_s,
                schedule.sequence,
                self._plant.valves[tag].wiring.command.bus,
                self._gateway,
                dict(schedule.overrides),
                requested_by,
                until=None if schedule.until is None else dict(schedule.until),
            )
            stored = await asyncio.to_thread(self._table.insert, check)
            if stored is None:
                continue  # it was queued before: a doubled firing, or a look that was cut off
            checks.append(stored)
            reason = check.missed(self._clock()) if missed else await self._overlap(stored)
            if reason:
                await self._end(stored, CheckState.SKIPPED, reason)
            else:
                await self._enqueue(stored)
        _LOG.info("schedule due", schedule=schedule.name, occurrence=occurrence.name, checks=len(checks), missed=missed)
        return [await asyncio.to_thread(self._table.get, check.id) for check in checks]

    async def _overlap(self, check: Check) -> str:
        """Why a check is not queued while an earlier one of the same valve and schedule has not ended."""
        other = await asyncio.to_thread(self._table.unfinished_beside, check)
        if other is None:
            return ""
        return say(
            "check_overlaps",
            "its check of {occurrence} is still {state}: one at a time",
            occurrence=other.occurrence,
            state=other.state.value,
        )

    async def _enqueue(self, check: Check) -> None:
        assert self._queue is not None, "start comes first"
        job_id = f"{check.id}:{self._process}"  # another process's job of this check finds it taken up, or is the same
        await asyncio.to_thread(self._queue.enqueue, job_id, check.bus, check.id)

    def carry_out_in_thread(self, check_id: int) -> str:
        """Carry a check out from a thread of the queue; return how it stands then."""
        if self._loop is None or self._closing.is_set():
            return CheckState.QUEUED.value
        carried = asyncio.run_coroutine_threadsafe(self.carry_out(check_id), self._loop)
        self._carried.add(carried)
        try:
            return carried.result()
        except CancelledError:
            return CheckState.RUNNING.value
        finally:
            self._carried.discard(carried)

    async def carry_out(self, check_id: int) -> str:
        """Wait for a check's turn and carry it out until its valve rests; return how it stands then."""
        check = await asyncio.to_thread(self._table.get, check_id)
        if check.state is CheckState.RUNNING and check.attempt != self._process:
            await self._note_cut_off(check)
        if check.state is not CheckState.QUEUED:
            return check.state.value
        reason = self._withdrawn(check)
        if reason:
            return await self._end(check, CheckState.SKIPPED, reason)
        while not self._closing.is_set():
            busy = self._runs.why_not_scheduled(check.valve)
            if self._clock() > check.ends_at:
                return await self._end(check, CheckState.SKIPPED, check.too_late(busy or reason))
            if not busy:
                waits = await self._attempt(check)
                if waits is None:
                    break
                reason = waits
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), _TURN_S)
        return (await asyncio.to_thread(self._table.get, check_id)).state.value

    def _withdrawn(self, check: Check) -> str:
        """Why a check that was queued may not be carried out any more; only what plant.toml approves is."""
        for schedule in self._plant.schedules:
            if schedule.name == check.schedule and check.valve in schedule.valves:
                asked = (schedule.sequence, schedule.overrides, schedule.until)
                if asked == (check.sequence, check.overrides, check.until):
                    return ""
                return say(
                    "another_test_asked", "plant.toml asks for another test since: {test}", test=schedule.sequence
                )
        return say(
            "not_in_schedule",
            "plant.toml no longer has {valve} in schedule {schedule}",
            valve=check.valve,
            schedule=check.schedule,
        )

    async def _attempt(self, check: Check) -> str | None:
        """Start a check's test; None once it is done with, or why it has to wait."""
        if not await asyncio.to_thread(self._table.take_up, check.id, self._process, self._clock()):
            return None
        requester = Requester(f"schedule {check.schedule}"[:64], RequesterKind.SCHEDULE)
        try:
            run = await self._runs.start(
                check.valve,
                check.sequence,
                check.overrides,
                check.key,
                requester=requester,
                schedule=check.schedule,
                until=check.until,
            )
        except (BusyError, MotionLostError) as error:  # a motion process that is being started again comes back
            await asyncio.to_thread(self._table.put_back, check.id, self._process)
            return message_of(error)
        except PermissiveError as error:
            await self._end(check, CheckState.SKIPPED, message_of(error))
            return None
        except ValveError as error:
            await self._end(
                check, CheckState.FAILED, say("check_not_moved", "{why} (nothing was moved)", why=message_of(error))
            )
            return None
        await asyncio.to_thread(self._table.note_test, check.id, run.id)
        followed = self._follow(check, run)
        if len(self._tasks) > max(_FEWEST_FOLLOWED, 2 * len(self._plant.buses)):
            await followed
        else:
            self._spawn(followed)
            await self._runs.rest(run.id)
        return None

    async def _follow(self, check: Check, run: Run) -> None:
        """Wait for a test's end and write down how the check ended."""
        while not run.state.finished:
            run = await self._runs.wait(run.id, _LOOK_S)
        await self._end(check, _BY_TEST.get(run.state, CheckState.FAILED), _reason_of(run))

    async def _note_cut_off(self, check: Check) -> None:
        """Write down the end of a check whose process died: with its test's, where that came to one."""
        state, reason = CheckState.INTERRUPTED, _CUT_OFF
        run = await asyncio.to_thread(self._known.by_idempotency_key, check.key)
        if run is not None:
            await asyncio.to_thread(self._table.note_test, check.id, run.id)
            run = self._runs.as_it_stands(run)
            if not run.state.finished:  # it was rejoined or taken up: the check ends with it
                self._spawn(self._follow(check, run))
                return
            if run.state.finished:
                state, reason = _BY_TEST.get(run.state, CheckState.FAILED), _reason_of(run)
        await self._end(check, state, reason)

    async def _end(self, check: Check, state: CheckState, reason: str) -> str:
        await asyncio.to_thread(partial(self._table.end, check.id, state, reason, self._clock()))
        _LOG.info("check ended", valve=check.valve, schedule=check.schedule, state=state.value, reason=reason)
        return state.value


def _reason_of(run: Run) -> str:
    """Why a test ended badly, or before its sequence did as its valve's limits ask; "" of any other."""
    is_cut = event_of_early(run.ended_early) is not None
    return run.error or (early_words(run.until, run.ended_early) if is_cut else "")
