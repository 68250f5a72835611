"""Runs: asked for, watched, stopped, and brought to an end when the service ends."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Collection, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final
from weakref import WeakValueDictionary

import structlog

from drivers.addresses import BusAddress, Mode
from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink, MotionLostError, Order
from drivers.motion.plant_read import valve_read
from drivers.waveform_check import check_waveform
from service.config.plant import Plant, PlantValve
from service.model.acknowledgement import acknowledged, ended_badly, is_moving
from service.model.analysis import can_be_analysed
from service.model.requester import LOCAL, Requester
from service.model.run import Label, Run, RunState, checked_run_id, new_run_id
from service.model.sequences import choose_waveform
from service.model.until import SEPARATING, until_of
from service.recordings.place import recording_of
from service.runs.admission import Admission
from service.runs.again import analyse_again, begun_again
from service.runs.analyst import Analyst
from service.runs.bus_owners import Claim
from service.runs.description import DESCRIBED, description_of
from service.runs.events import Event
from service.runs.execution import Execution, OnSamples
from service.runs.live import LiveRun, LiveRuns
from service.runs.live_estimates import Estimator, LiveEstimates
from service.runs.permission import Permission
from service.runs.recovery import Recovery
from service.runs.separating import check_name, separating_of
from service.runs.stem_looks import StemLooks
from service.runs.tasks import Tasks
from service.store.run_filter import RunFilter
from service.store.store import Store
from service.workers.polling import Polling
from valve.errors import BusyError, ElsewhereError, InternalError, NotFoundError, RequestError
from valve.messages import say
from valve.waveform import Waveform

_LOG = structlog.get_logger(__name__)
_SOON_S: Final = 1.0  # whoever asks so shortly before a stem is looked at waits for that
_LOOK_S: Final = 0.01
_END_TOLD_S: Final = 1.0  # a stop that is carried out is answered so much later at most
_MOTION_STARTS_S: Final = 15.0
_STORE_AGAIN_S: Final = 2.0  # a look at the disk costs nothing, and somebody may be freeing it


class Runs:
    """Every run of this process. All methods belong to the event loop."""

    def __init__(
        self,
        plant: Plant,
        store: Store,
        motion: MotionLink,
        analyst: Analyst,
        *,
        software: str,
        audit: AuditLog | None = None,
        on_samples: OnSamples = lambda *_: None,
        estimator: Estimator | None = None,
        polling: Polling | None = None,
    ) -> None:
        self._polling = polling or Polling()
        self._on_samples = on_samples
        self._estimator = estimator
        self._plant = plant
        self._store = store
        self._motion = motion
        self._analyst = analyst
        self._software = software
        self._audit = audit
        self._admission = Admission(plant, store, motion)
        self._live = LiveRuns()
        self._tasks = Tasks()
        self._looks = StemLooks(store, motion, self._admission, self._tasks, audit)
        self._recovery = Recovery(plant, store, motion, self._admission, self._tasks, looks=self._looks, audit=audit)
        self._closing = False
        self._carrying: WeakValueDictionary[str, asyncio.Task[None]] = WeakValueDictionary()  # by the run's id
        self._analysing = asyncio.Lock()

    def valve(self, tag: str) -> PlantValve:
        """Return the valve of this tag. Raises NotFoundError."""
        if tag not in self._plant.valves:
            raise NotFoundError(
                say("valve_unknown", "valve {valve} is unknown: GET /valves lists all", valve=repr(tag[:64]))
            )
        return self._plant.valves[tag]

    def add_buses(self, buses: Mapping[str, BusAddress]) -> None:
        """Know buses that a reload has added."""
        self._admission.add_buses(buses)

    def user_of(self, tag: str) -> str | None:
        """Return the id of the run that uses this valve now, if any."""
        return self._admission.owners.tester(tag)

    def why_not_scheduled(self, tag: str) -> str:
        """Return why a scheduled test of a valve has to wait now; "" where it may start."""
        return self._admission.owners.why_not_scheduled(tag, self.valve(tag).buses)

    def _check_gateway(self, tag: str) -> None:
        if not self._plant.is_ours(tag):
            gateway = self._plant.gateway_of(tag)
            raise ElsewhereError(
                say("other_gateway_drives", "{tag}: gateway {gateway} drives this valve", tag=tag, gateway=gateway),
                gateway,
                self._plant.gateways[gateway],
            )

    async def start(
        self,
        tag: str,
        sequence: str | None,
        overrides: Mapping[str, Any],
        idempotency_key: str | None = None,
        *,
        requester: Requester = LOCAL,
        schedule: str | None = None,
        label: Label | None = None,
        permit: str | None = None,
        until: Mapping[str, Any] | None = None,
    ) -> Run:
        """Start a test; its intent is on disk when this returns. A known key returns the run that it asked for first.

        Without a sequence the usual one is run, or the one that the valve's limits allow; ``separating`` is what the
        last completed test asks for, and is analysed together with it. ``schedule`` names the one
        that asks, ``permit`` the work permit where the valve demands one. ``until`` is how well figures are to be
        known for the test to end before its sequence does (``service.model.until``).

        Raises NotFoundError, ElsewhereError, BusyError, PermissiveError, WaveformError and RequestError; then nothing
        was stored and nothing moves.
        """
        valve = self.valve(tag)
        self._check_gateway(tag)
        wish = until_of(tag, valve.wiring.acquisition.mode, sequence, until)
        together: tuple[str, ...] = ()
        if sequence is not None:
            check_name(sequence)
        if sequence == SEPARATING:
            if overrides:
                raise RequestError(
                    say(
                        "separating_takes_no_overrides",
                        "sequence {sequence} takes no overrides, as the last test says them: drop them",
                        sequence=SEPARATING,
                    )
                )
            asked = Run(new_run_id(), tag, SEPARATING, idempotency_key=idempotency_key, label=label)
            known = await self._asked_before(asked, permit)
            if known is not None:
                return known
            told = await asyncio.to_thread(separating_of, self._store, tag)
            choice = choose_waveform(told.sequence, told.overrides, valve.nameplate, valve.wiring.limits)
            together = told.tests
        else:
            choice = choose_waveform(sequence, overrides, valve.nameplate, valve.wiring.limits)
        check_waveform(tag, choice.waveform, valve.wiring.limits)
        wanted = Run(
            id=new_run_id(),
            valve=tag,
            sequence=SEPARATING if together else choice.name,
            overrides=dict(overrides),
            idempotency_key=idempotency_key,
            software=self._software,
            requested_by=requester.name,
            schedule=schedule,
            gateway=self._plant.service.gateway,
            label=label,
            until=wish,
        )
        await self._looked_at(tag)
        async with self._admission.turn(valve):
            known = await self._asked_before(wanted, permit)
            if known is not None:
                return known
            if self._closing:
                raise BusyError(
                    say(
                        "valve_shutting_down",
                        "{tag}: the service is shutting down: repeat the request when it is back",
                        tag=tag,
                    )
                )
            stored, claim = await self._admission.admit(wanted, valve, permit)
            live = self._live.begin(replace(stored, until=wish))
            estimates = self._estimates(live, valve, choice.waveform)
            order = Order(
                stored.id,
                tag,
                choice.waveform,
                choice.name,
                stored.number,
                permit,
                requester.name,
                software=self._software,
                may_end_early=estimates is not None and (wish is not None or valve.wiring.limits.end_out_of_family),
                until=wish,
                together=together,
                read=valve_read(valve.wiring, self._plant.buses),
            )
            execution = self._execution(live, valve, order, claim, estimates)
            self._carrying[stored.id] = self._tasks.spawn(self._carry_out(execution, live))
        because = {"because": choice.reason} if choice.reason else {}
        _LOG.info("test accepted", test=stored.id, valve=tag, sequence=choice.name, run_number=stored.number, **because)
        return live.run

    def _execution(
        self, live: LiveRun, valve: PlantValve, order: Order, claim: Claim, estimates: LiveEstimates | None = None
    ) -> Execution:
        return Execution(
            live,
            valve,
            order,
            claim,
            store=self._store,
            owners=self._admission.owners,
            looks=self._looks,
            together=order.together,
            on_samples=self._on_samples,
            estimates=estimates,
        )

    def _estimates(
        self, live: LiveRun, valve: PlantValve, waveform: Waveform, *, joins: bool = False
    ) -> LiveEstimates | None:
        """Return what estimates a test while it runs; None where nobody can, and where its device plays by itself.

        ``joins`` where the test runs already.
        """
        if self._estimator is None or valve.wiring.acquisition.mode is not Mode.POLLED:
            return None
        return LiveEstimates(
            live,
            waveform,
            nameplate=valve.nameplate,
            journal=self._store.journal_path(live.run.id),
            estimator=self._estimator,
            spawn=self._tasks.spawn,
            ends_out_of_family=valve.wiring.limits.end_out_of_family,
            joins=joins,
        )

    async def _carry_out(self, execution: Execution, live: LiveRun, *, rejoined: bool = False) -> None:
        """Let a test run to its end; an end that the store could not take is stored as soon as it can be.

        Until then the next start would know nothing of a bad end, and the disk alone would bar it.
        """
        await execution.run(self._motion, self._analyst, polling=self._polling, rejoined=rejoined)
        if execution.is_lost:
            await self._interrupt(live)
        while not execution.is_end_stored and not self._closing:
            await asyncio.sleep(_STORE_AGAIN_S)
            try:
                await asyncio.to_thread(self._store.runs.save, live.run)
            except Exception as error:  # noqa: BLE001  - whatever the store lacks now it may have later
                _LOG.warning("end of test still not stored", test=live.run.id, error=str(error))
            else:
                execution.is_end_stored = True
                _LOG.warning("end of test stored late", test=live.run.id)

    async def _interrupt(self, live: LiveRun) -> None:
        """Mark a test whose motion was lost, have its valve looked at as soon as that can be, and tell the watchers."""
        live.at_rest.set()  # whoever waits for it waits in vain
        live.motion_ended.set()
        while not self._closing:
            try:
                run = await asyncio.to_thread(self._store.runs.get, live.run.id)
                live.run = await self._recovery.interrupt(run)
            except Exception as error:  # noqa: BLE001  - whatever the store lacks now it may have later
                _LOG.warning("lost test still not marked", test=live.run.id, error=str(error))
                await asyncio.sleep(_STORE_AGAIN_S)
            else:
                live.announce()
                self._live.forget(live.run.id)  # what is found out of its valve goes into the store
                return

    async def permission(self, tag: str, permit: str | None = None) -> tuple[Permission | None, str]:
        """Return what must hold before this valve may move, read fresh without moving it, and why it is not fresh.

        ``permit`` is the work permit that a test would name, where the valve demands one.
        While a bus of it is used the last ones are returned (None where there are none) with the reason.
        Raises NotFoundError, ElsewhereError.
        """
        valve = self.valve(tag)
        self._check_gateway(tag)
        return await self._admission.permission(valve, permit)

    async def acknowledge(self, run_id: str, requester: Requester, note: str) -> Run:
        """Note that somebody looked at the valve after a test that ended badly; the first note stays.

        Raises NotFoundError, and RequestError where there is nothing to acknowledge or the test still runs.
        """
        run = await self.get(run_id)
        await self._looked_at(run.valve)
        run = await self.get(run_id)
        if run.acknowledged_at is not None:
            return run
        if not ended_badly(run):
            raise RequestError(
                say(
                    "nothing_to_acknowledge",
                    "test {test} is {state} and needs no acknowledgement: nothing to do",
                    test=run.id,
                    state=run.state.value,
                )
            )
        if run.stands is not None and is_moving(run):
            raise RequestError(
                say(
                    "acknowledge_later",
                    "test {test}: the stem may still move and is looked at {due:g s} after the motion: "
                    "acknowledge when it was",
                    test=run.id,
                    due=run.stands.due_s,
                )
            )
        live = self._live.find(run.id)
        if self._audit is not None:
            append = partial(self._audit.append, "test.acknowledged", valve=run.valve, test=run.id)
            await asyncio.to_thread(append, who=requester.name, details={"note": note})
        async with contextlib.nullcontext() if live is None else live.storing:
            changed = acknowledged(run if live is None else live.run, requester.name, note)
            await asyncio.to_thread(self._store.runs.save, changed)
            if live is not None:
                live.run = changed
        _LOG.warning("test acknowledged", test=run.id, valve=run.valve, by=requester.name, note=note)
        return changed

    async def describe(self, run_id: str, requester: Requester, said: Mapping[str, Any]) -> Run:
        """Change what people say of a test: ``label``, ``work_order`` and ``note``, those that ``said`` has.

        It is in the audit log, with what it was before, ere it is stored. Raises NotFoundError, AuditError.
        """
        live = self._live.find(checked_run_id(run_id))
        async with contextlib.nullcontext() if live is None else live.storing:
            run = await asyncio.to_thread(self._store.runs.get, run_id) if live is None else live.run
            found = description_of(run, said, requester.name)
            if not found.changes:
                return run
            if self._audit is not None:
                append = partial(self._audit.append, DESCRIBED, valve=run.valve, test=run.id)
                details = {"was": dict(found.was), "now": dict(found.now)}
                await asyncio.to_thread(append, who=requester.name, details=details)
            stored = await asyncio.to_thread(self._store.runs.change, run.id, found.changes)
            if live is None:
                return stored
            live.run = replace(live.run, **found.changes)
            return live.run

    def any_under_way(self) -> bool:
        """Whether a test of this process has not ended yet."""
        return any(not live.finished.is_set() for live in self._live)

    async def running_test_of(self, tag: str) -> str:
        """Return the id of the test that uses a valve now. Raises NotFoundError where none does."""
        self.valve(tag)
        run_id = self.user_of(tag)
        if run_id is None:
            raise NotFoundError(
                say("nothing_to_stop", "{tag}: no test uses this valve now: there is nothing to stop", tag=tag)
            )
        return run_id

    async def _looked_at(self, tag: str) -> None:
        """Return when the stem of a valve that was just tested was looked at, where that is about to happen."""
        until_s = time.monotonic() + _SOON_S
        while time.monotonic() < until_s:
            live = self._live.find(self._admission.owners.holder(tag) or "")
            is_over = live is not None and (live.motion_ended.is_set() or live.run.state.finished)
            if not is_over or self._looks.due_in_s(tag) > _SOON_S:
                return
            await asyncio.sleep(_LOOK_S)

    async def _asked_before(self, wanted: Run, permit: str | None) -> Run | None:
        known = await self._admission.known(wanted, permit)
        if known is None:
            return None
        run = await self.get(known.id)
        is_kept = run.quality is not None or not run.state.finished  # of a test that was cut off it is not
        if is_kept and run.until != wanted.until:
            raise RequestError(
                say(
                    "key_used_with_other_until",
                    "Idempotency-Key {key} was used with another until (test {test}): choose a new key for a new test",
                    key=repr(wanted.idempotency_key),
                    test=known.id,
                )
            )
        return run

    async def get(self, run_id: str) -> Run:
        """Return a run as it stands now. Raises NotFoundError."""
        live = self._live.find(checked_run_id(run_id))
        return await asyncio.to_thread(self._store.runs.get, run_id) if live is None else live.run

    async def newest(self, limit: int, wanted: RunFilter = RunFilter(), *, before: str | None = None) -> list[Run]:
        """Runs that are meant and older than the run ``before``, newest first. Raises NotFoundError."""
        number = None if before is None else (await self.get(before)).number
        runs = await asyncio.to_thread(self._store.runs.newest, limit, before=number, wanted=wanted)
        return [self.as_it_stands(run) for run in runs]

    def as_it_stands(self, run: Run) -> Run:
        """Return a stored run with the progress that only the memory knows."""
        live = self._live.find(run.id)
        return run if live is None else live.run

    async def wait(self, run_id: str, timeout_s: float) -> Run:
        """Return a run when it has ended or when the time is over."""
        live = self._live.find(run_id)
        if live is not None and timeout_s > 0.0:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(live.finished.wait(), timeout_s)
        return await self.get(run_id)

    def at_rest(self, run_id: str) -> bool:
        """Whether the valve of a run stands."""
        live = self._live.find(run_id)
        return live is None or live.at_rest.is_set()

    async def rest(self, run_id: str) -> None:
        """Return when the valve of a run moves no more."""
        live = self._live.find(run_id)
        if live is not None:
            await live.motion_ended.wait()

    def under_way_since_s(self, run_id: str) -> float | None:
        """Return when a test began that has not ended, by the monotonic clock; None for all others."""
        live = self._live.find(run_id)
        return None if live is None or live.finished.is_set() else live.began_s

    async def stop(self, run_id: str, requester: Requester = LOCAL, *, timeout_s: float = 8.0) -> Run:
        """Send the valve of a run to safe at once and return when it is there; what has ended stays as it is.

        Of a test that runs neither database nor thread is asked. Who stopped it goes into the audit log when the valve
        stands.
        """
        live = self._live.find(checked_run_id(run_id))
        if live is None or live.finished.is_set():
            return await self.get(run_id)
        live.request_stop(say("stopped_by", "stopped by {who}", who=requester.name))
        if not live.motion_ended.is_set():
            self._motion.stop(run_id, live.stop_reason)  # each press once more: the first one may have been lost
        if not live.motion_ended.is_set() and requester.name not in live.stopped_by:
            live.stopped_by.add(requester.name)
            self._tasks.spawn(self._note_stop(live, requester, datetime.now(UTC)))
        try:
            async with asyncio.timeout(timeout_s):
                await live.at_rest.wait()
        except TimeoutError:
            _LOG.error("stop takes long", test=run_id, seconds=timeout_s)
        with contextlib.suppress(TimeoutError):  # where the store answers, its end is told too
            async with asyncio.timeout(_END_TOLD_S):
                await live.motion_ended.wait()
        return live.run

    async def _note_stop(self, live: LiveRun, requester: Requester, asked_at: datetime) -> None:
        """Write who stopped a test, once its valve stands: nothing of this may hold the stop up."""
        await live.at_rest.wait()
        run = live.run
        details = {"kind": requester.kind.value, "asked_at": asked_at.isoformat(), "safe_confirmed": run.safe_confirmed}
        _LOG.warning("test stopped", test=run.id, valve=run.valve, by=requester.name)
        if self._audit is not None:
            append = partial(self._audit.append, "test.stopped", valve=run.valve, test=run.id, details=details)
            try:
                await asyncio.to_thread(append, who=requester.name)
            except InternalError as error:
                _LOG.error("stop is not in the audit log", test=run.id, by=requester.name, error=str(error))

    async def follow(self, run_id: str, after: int) -> AsyncIterator[tuple[Event, ...]]:
        """Return the events of a run with an id above ``after``, as ``EventLog.follow``. Raises NotFoundError."""
        live = self._live.find(checked_run_id(run_id))
        if live is None:
            live = LiveRun(await asyncio.to_thread(self._store.runs.get, run_id))
        return live.events.follow(after)

    async def recover(self) -> None:
        """Send the valves that a dead process left to safe and mark its tests; returns when they are marked.

        Analyses that it left unfinished are made again: they move nothing.
        """
        for run in await self._recovery.begin(await self._rejoin()):
            _LOG.warning("analysis taken up", test=run.id, valve=run.valve)
            await self._begin_analysis(run, self.valve(run.valve), by="service")

    async def _rejoin(self) -> Collection[str]:
        """Go on with the tests whose motion outlived the process that asked for it; return them.

        Raises BusyError where the motion process is of another version, or has another service: then nobody may say
        of a test that it was interrupted.
        """
        gateway, unfinished = self._plant.service.gateway, (RunState.QUEUED, RunState.RUNNING)
        runs = await asyncio.to_thread(self._store.runs.in_states, unfinished, gateway=gateway)
        try:
            await self._motion.connect(_MOTION_STARTS_S if runs else 0.0)  # it may be starting as we are
            left = {one.order.run_id: one.order for one in await self._motion.left()}
        except MotionLostError as error:
            _LOG.error("no motion process", reason=str(error))
            return ()
        alive = {run.id: run for run in runs if run.id in left and run.valve in self._plant.valves}
        for run_id, order in left.items():
            run = alive.get(run_id)
            if run is not None:
                self._tasks.spawn(self._go_on(run, order))
            else:
                self._motion.stop(run_id, say("valve_no_longer_named", "plant.toml no longer names this valve"))
                self._motion.forget(run_id)
        return alive.keys()

    async def _go_on(self, run: Run, order: Order) -> None:
        valve = self.valve(run.valve)
        live = self._live.begin(replace(run, until=order.until))
        claim = await self._admission.claim_when_free(run, valve)
        estimates = self._estimates(live, valve, order.waveform, joins=True) if order.may_end_early else None
        execution = self._execution(live, valve, order, claim, estimates)
        _LOG.warning("test rejoined", test=run.id, valve=run.valve)
        self._carrying[run.id] = self._tasks.spawn(self._carry_out(execution, live, rejoined=True))

    async def analyze(self, run_id: str, requester: Requester = LOCAL) -> Run:
        """Analyse the recording of a test anew, with what is known now; returns when that has begun.

        Raises NotFoundError, ElsewhereError where another gateway has the recording, BusyError while the test is under
        way, RequestError where its motion did not end well: such a recording is no whole test.
        """
        async with self._analysing:
            run, valve = await self._analysable(run_id)
            if self._audit is not None:
                append = partial(self._audit.append, "analysis.repeated", valve=run.valve, test=run.id)
                former = {"was": run.state.value, "error": run.error}
                await asyncio.to_thread(append, who=requester.name, details=former)
            return await self._begin_analysis(run, valve, by=requester.name)

    async def analyze_behind(self, run_id: str, by: str) -> Run:
        """Do as ``analyze``, behind whatever else is to be analysed; whoever asked for many tests is noted once."""
        async with self._analysing:
            run, valve = await self._analysable(run_id)
            return await self._begin_analysis(run, valve, by=by, behind=True)

    async def _analysable(self, run_id: str) -> tuple[Run, PlantValve]:
        """Return a test whose recording may be analysed anew now, with its valve. Raises as ``analyze``."""
        run = await self.get(run_id)
        if not run.state.finished or self._closing:
            why = (
                say("service_shutting_down", "the service is shutting down")
                if self._closing
                else say("test_is_in_state", "test {test} is {state}", test=run.id, state=run.state.value)
            )
            raise BusyError(say("repeat_later", "{valve}: {why}: repeat the request later", valve=run.valve, why=why))
        valve = self.valve(run.valve)
        if not can_be_analysed(run):
            raise RequestError(
                say(
                    "nothing_to_analyse_again",
                    "test {test} is {state} and has no whole recording of a motion that ended well: repeat the "
                    "test, or take what there is of its recording to breakaway analyze",
                    test=run.id,
                    state=run.state.value,
                )
            )
        recording_of(run, self._plant, self._store)
        return run, valve

    async def _begin_analysis(self, run: Run, valve: PlantValve, *, by: str, behind: bool = False) -> Run:
        # These fields alone: after a restart the stem is looked at meanwhile, and what was seen of it stays.
        changed = await asyncio.to_thread(self._store.runs.change, run.id, begun_again(run))
        live = self._live.begin(changed)
        live.at_rest.set()
        live.motion_ended.set()
        about = {"by": by, "at": datetime.now(UTC).isoformat(), "software": self._software}
        work = analyse_again(live, valve, self._store, self._analyst, about=about, behind=behind)
        self._carrying[run.id] = self._tasks.spawn(work)
        return changed

    async def settled(self) -> None:
        """Return when everything that this process has under way, recovery included, has come to its end."""
        await self._tasks.settled()

    def begin_shutdown(self) -> None:
        """Accept no further test and stop those that run.

        Analyses, and motions that outlive this process, are left to the next start.
        """
        self._closing = True
        self._looks.close()
        for live in self._live:
            goes_on = self._motion.outlives_us and not live.motion_ended.is_set()
            if not goes_on:
                live.request_stop(say("stopped_service_shut_down", "stopped: the service was shut down"))
            if (goes_on or live.run.state is RunState.ANALYZING) and live.run.id in self._carrying:
                self._carrying[live.run.id].cancel()
                live.events.close()  # who watches sees the end at the next start

    async def shut_down(self, timeout_s: float = 20.0) -> None:
        """Stop every run and wait until its valve is safe and its end is stored."""
        self.begin_shutdown()
        await self._tasks.end(timeout_s)
