"""Runs: asked for, watched, stopped, and brought to an end when the service ends."""

from __future__ import annotations

import asyncio
import contextlib
from collections import OrderedDict
from collections.abc import AsyncIterator, Coroutine, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final, TypeVar

import structlog

from drivers.permissives import require_met
from service.audit.log import AuditLog
from service.bus import BusOwners, Claim
from service.bus_lock import BusLocks
from service.events import Event
from service.runs.acknowledgement import acknowledged, ended_badly, last_end
from service.runs.life import NOT_CONFIRMED, Analyst, Life, OnSamples
from service.runs.live import LiveRun
from service.runs.permission import Permission, free_disk
from service.runs.recovery import (
    UNFINISHED,
    entry_pressure_pa,
    keep_journals_of_ended_runs,
    mark_interrupted,
    needs_safe,
)
from service.runs.requester import LOCAL, Requester
from service.runs.rig import Order, Rig
from service.runs.run import Label, Run, checked_run_id, new_run_id
from service.runs.separating import SEPARATING, separating_of
from service.runs.sequences import choose_waveform
from service.settings import Plant, PlantValve
from service.store.store import Store
from valve.errors import BusyError, ElsewhereError, InternalError, NotFoundError, RequestError

Result = TypeVar("Result")

_LOG = structlog.get_logger(__name__)
_CANCELLED_S: Final = 5.0
_REMEMBERED_RUNS: Final = 32  # finished runs whose events can still be followed


class Runs:
    """Every run of this process. All methods belong to the event loop."""

    def __init__(
        self,
        plant: Plant,
        store: Store,
        rig: Rig,
        analyst: Analyst,
        *,
        software: str,
        audit: AuditLog | None = None,
        on_samples: OnSamples = lambda *_: None,
    ) -> None:
        self._on_samples = on_samples
        self._plant = plant
        self._store = store
        self._rig = rig
        self._analyst = analyst
        self._software = software
        self._audit = audit
        self._locks = BusLocks(plant.buses)
        self._owners = BusOwners(locks=self._locks)
        self._bus_turns = {name: asyncio.Lock() for name in plant.buses}
        self._permissions: dict[str, Permission] = {}  # as they were read last, by tag
        self._live: OrderedDict[str, LiveRun] = OrderedDict()
        self._tasks: set[asyncio.Task[Any]] = set()
        self._admission = asyncio.Lock()
        self._closing = False

    def valve(self, tag: str) -> PlantValve:
        """Return the valve of this tag. Raises NotFoundError."""
        if tag not in self._plant.valves:
            raise NotFoundError(f"valve {tag[:64]!r} is unknown: GET /valves lists all")
        return self._plant.valves[tag]

    def user_of(self, tag: str) -> str | None:
        """Return the id of the run that uses this valve now, if any."""
        return self._owners.holder(tag)

    def why_not_scheduled(self, tag: str) -> str:
        """Return why a scheduled test of a valve has to wait now; "" where it may start."""
        return self._owners.why_not_scheduled(tag, self.valve(tag).buses)

    def _check_gateway(self, tag: str) -> None:
        if not self._plant.is_ours(tag):
            gateway = self._plant.gateway_of(tag)
            raise ElsewhereError(f"{tag}: gateway {gateway} drives this valve", gateway, self._plant.gateways[gateway])

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
    ) -> Run:
        """Start a test; its intent is on disk when this returns. A known key returns the run that it asked for first.

        Without a sequence the usual one is run, or the one that the valve's limits allow; ``separating`` is what the
        last completed test asks for, and is analysed together with it. ``schedule`` names the one
        that asks, ``permit`` the work permit where the valve demands one.

        Raises NotFoundError, ElsewhereError, BusyError, PermissiveError, WaveformError and RequestError; then nothing
        was stored and nothing moves.
        """
        valve = self.valve(tag)
        self._check_gateway(tag)
        together: tuple[str, ...] = ()
        if sequence == SEPARATING:
            if overrides:
                raise RequestError(f"sequence {SEPARATING} takes no overrides, as the last test says them: drop them")
            asked = Run(id=new_run_id(), valve=tag, sequence=SEPARATING, idempotency_key=idempotency_key)
            known = await self._asked_before(asked)
            if known is not None:
                return known
            wish = await asyncio.to_thread(separating_of, self._store, tag)
            choice = choose_waveform(wish.sequence, wish.overrides, valve.nameplate, valve.wiring.limits)
            together = wish.tests
        else:
            choice = choose_waveform(sequence, overrides, valve.nameplate, valve.wiring.limits)
        self._rig.check(valve, choice.waveform)
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
        )
        async with self._turn(valve):
            known = await self._asked_before(wanted)
            if known is not None:
                return known
            if self._closing:
                raise BusyError(f"{tag}: the service is shutting down: repeat the request when it is back")
            claim = self._owners.claim(wanted.id, tag, valve.buses, scheduled=schedule is not None)
            try:
                permission = await self._read_permission(valve, permit)
                require_met(tag, permission.permissives)
                async with self._admission:
                    known = await self._asked_before(wanted)  # of another valve, meanwhile: then it is refused
                    assert known is None
                    wanted = replace(wanted, permissives=permission.to_json())
                    stored = await asyncio.to_thread(self._store.runs.insert, wanted)
            except BaseException:
                self._owners.release(claim)
                raise
            live = self._remember(stored)
            order = Order(valve, choice.waveform, choice.name, stored.number, permit)
            life = Life(
                live,
                order,
                claim,
                self._store,
                self._owners,
                audit=self._audit,
                together=together,
                on_samples=self._on_samples,
            )
            self._spawn(life.run(self._rig, self._analyst))
        because = {"because": choice.reason} if choice.reason else {}
        _LOG.info("test accepted", test=stored.id, valve=tag, sequence=choice.name, run_number=stored.number, **because)
        return live.run

    @contextlib.asynccontextmanager
    async def _turn(self, valve: PlantValve) -> AsyncIterator[None]:
        """Wait for the buses of a valve as long as somebody only reads there; a test that runs is not waited for."""
        async with contextlib.AsyncExitStack() as stack:
            for bus in sorted(valve.buses):
                await stack.enter_async_context(self._bus_turns[bus])
            yield

    async def _read_permission(self, valve: PlantValve, permit: str | None) -> Permission:
        found = await self._rig.permissives(valve, permit)
        last = await asyncio.to_thread(self._store.runs.newest, 1, valve=valve.nameplate.tag)
        disk = await asyncio.to_thread(free_disk, self._store.folder)
        permission = Permission((*found, disk, last_end(last[0] if last else None)), datetime.now(UTC))
        self._permissions[valve.nameplate.tag] = permission
        return permission

    async def permission(self, tag: str, permit: str | None = None) -> tuple[Permission | None, str]:
        """Return what must hold before this valve may move, read fresh without moving it, and why it is not fresh.

        ``permit`` is the work permit that a test would name, where the valve demands one.
        While a bus of it is used the last ones are returned (None where there are none) with the reason.
        Raises NotFoundError, ElsewhereError.
        """
        valve = self.valve(tag)
        self._check_gateway(tag)
        async with self._turn(valve):
            in_use = self._owners.in_use(tag, valve.buses)
            if in_use:
                return self._permissions.get(tag), in_use
            try:
                with self._locks.hold(valve.buses):
                    return await self._read_permission(valve, permit), ""
            except BusyError as error:
                return self._permissions.get(tag), str(error)

    async def acknowledge(self, run_id: str, requester: Requester, note: str) -> Run:
        """Note that somebody looked at the valve after a test that ended badly; the first note stays.

        Raises NotFoundError, and RequestError where there is nothing to acknowledge or the test still runs.
        """
        run = await self.get(run_id)
        if run.acknowledged_at is not None:
            return run
        if not ended_badly(run):
            raise RequestError(f"test {run.id} is {run.state.value} and needs no acknowledgement: nothing to do")
        live = self._live.get(run.id)
        changed = acknowledged(run, requester.name, note)
        if self._audit is not None:
            append = partial(self._audit.append, "test.acknowledged", valve=run.valve, test=run.id)
            await asyncio.to_thread(append, who=requester.name, details={"note": note})
        await asyncio.to_thread(self._store.runs.save, changed)
        if live is not None:
            live.run = changed
        _LOG.warning("test acknowledged", test=run.id, valve=run.valve, by=requester.name, note=note)
        return changed

    async def running_test_of(self, tag: str) -> str:
        """Return the id of the test that uses a valve now. Raises NotFoundError where none does."""
        self.valve(tag)
        run_id = self.user_of(tag)
        if run_id is None:
            raise NotFoundError(f"{tag}: no test uses this valve now: there is nothing to stop")
        return run_id

    async def _asked_before(self, wanted: Run) -> Run | None:
        if wanted.idempotency_key is None:
            return None
        known = await asyncio.to_thread(self._store.runs.by_idempotency_key, wanted.idempotency_key)
        if known is None:
            return None
        if (known.valve, known.sequence, known.overrides) != (wanted.valve, wanted.sequence, wanted.overrides):
            raise RequestError(
                f"Idempotency-Key {wanted.idempotency_key!r} was used for another request (test {known.id}): "
                "choose a new key for a new test"
            )
        return await self.get(known.id)

    def _remember(self, run: Run) -> LiveRun:
        live = LiveRun(run)
        self._live[run.id] = live
        finished = [key for key, other in self._live.items() if other.finished.is_set()]
        for key in finished[: max(0, len(self._live) - _REMEMBERED_RUNS)]:
            del self._live[key]
        return live

    def _spawn(self, work: Coroutine[Any, Any, Result]) -> asyncio.Task[Result]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def get(self, run_id: str) -> Run:
        """Return a run as it stands now. Raises NotFoundError."""
        live = self._live.get(checked_run_id(run_id))
        return await asyncio.to_thread(self._store.runs.get, run_id) if live is None else live.run

    async def newest(self, limit: int, *, before: str | None = None, tag: str | None = None) -> list[Run]:
        """Runs older than the run ``before``, newest first. Raises NotFoundError."""
        number = None if before is None else (await self.get(before)).number
        runs = await asyncio.to_thread(self._store.runs.newest, limit, before=number, valve=tag)
        return [self.as_it_stands(run) for run in runs]

    def as_it_stands(self, run: Run) -> Run:
        """Return a stored run with the progress that only the memory knows."""
        live = self._live.get(run.id)
        return run if live is None else live.run

    async def wait(self, run_id: str, timeout_s: float) -> Run:
        """Return a run when it has ended or when the time is over."""
        live = self._live.get(run_id)
        if live is not None and timeout_s > 0.0:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(live.finished.wait(), timeout_s)
        return await self.get(run_id)

    async def rest(self, run_id: str) -> None:
        """Return when the valve of a run moves no more."""
        live = self._live.get(run_id)
        if live is not None:
            await live.motion_ended.wait()

    async def stop(self, run_id: str, *, reason: str = "stopped on request", timeout_s: float = 8.0) -> Run:
        """Send the valve of a run to safe at once and return when it is there; what has ended stays as it is."""
        live = self._live.get(checked_run_id(run_id))
        if live is not None:
            live.request_stop(reason)
            try:
                await asyncio.wait_for(live.motion_ended.wait(), timeout_s)
            except TimeoutError:
                _LOG.error("stop takes long", test=run_id, seconds=timeout_s)
        return await self.get(run_id)

    async def follow(self, run_id: str, after: int) -> AsyncIterator[tuple[Event, ...]]:
        """Return the events of a run with an id above ``after``, as ``EventLog.follow``. Raises NotFoundError."""
        live = self._live.get(checked_run_id(run_id))
        if live is None:
            live = LiveRun(await asyncio.to_thread(self._store.runs.get, run_id))
        return live.events.follow(after)

    async def recover(self) -> None:
        """Send the valves that a dead process left to safe, each in a task of its own, and mark its tests.

        The valves come first: neither a long journal nor a full disk holds them up.
        """
        unfinished = await asyncio.to_thread(
            self._store.runs.in_states, UNFINISHED, gateway=self._plant.service.gateway
        )
        sent: dict[str, asyncio.Task[bool]] = {}
        for run in unfinished:
            if run.valve in self._plant.valves and needs_safe(run):
                entry_pa = await asyncio.to_thread(entry_pressure_pa, self._store, run)
                sent[run.id] = self._spawn(self._send_safe(run, entry_pa))
        marked = [await asyncio.to_thread(mark_interrupted, self._store, run) for run in unfinished]
        await asyncio.to_thread(keep_journals_of_ended_runs, self._store)
        for run in marked:
            if run.id in sent:
                self._spawn(self._note_safe(run.id, sent[run.id]))
            elif needs_safe(run):
                error = f"{run.error}; {NOT_CONFIRMED}: plant.toml no longer names it"
                await asyncio.to_thread(self._store.runs.save, replace(run, error=error, safe_confirmed=False))

    async def _send_safe(self, run: Run, entry_pa: float | None) -> bool:
        valve = self._plant.valves[run.valve]
        claim = await self._claim_when_free(run, valve)
        await self._note_in_audit("motion.recovery", run, {"run_number": run.number, "entry_pa": entry_pa})
        try:
            return await self._rig.go_safe(valve, run.number, entry_pa)
        except Exception as error:  # noqa: BLE001  - whatever it is, the result must say that the valve was not seen safe
            _LOG.error("valve not sent to safe", test=run.id, valve=run.valve, exc_info=error)
            return False
        finally:
            self._owners.release(claim)

    async def _note_in_audit(self, event: str, run: Run, details: Mapping[str, Any]) -> None:
        """Write what is done for safety's sake; where that cannot be written it is done all the same."""
        if self._audit is None:
            return
        try:
            await asyncio.to_thread(
                partial(self._audit.append, event, who="service", valve=run.valve, test=run.id, details=details)
            )
        except InternalError as error:
            _LOG.error("not in the audit log", test=run.id, audit_event=event, error=str(error))

    async def _note_safe(self, run_id: str, sent: asyncio.Task[bool]) -> None:
        confirmed = await sent
        await self._note_in_audit("motion.ended", await self.get(run_id), {"safe_confirmed": confirmed})
        run = await asyncio.to_thread(self._store.runs.get, run_id)
        error = run.error + ("; the valve was sent to its safe value" if confirmed else f"; {NOT_CONFIRMED}")
        await asyncio.to_thread(self._store.runs.save, replace(run, safe_confirmed=confirmed, error=error))
        _LOG.warning("valve sent to safe", test=run.id, valve=run.valve, confirmed=confirmed)

    async def _claim_when_free(self, run: Run, valve: PlantValve) -> Claim:
        while True:
            try:
                async with self._turn(valve):
                    return self._owners.claim(run.id, run.valve, valve.buses)
            except BusyError:
                await asyncio.sleep(0.05)

    async def settled(self) -> None:
        """Return when everything that this process has under way, recovery included, has come to its end."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))

    def begin_shutdown(self) -> None:
        """Accept no further test and stop those that run."""
        self._closing = True
        for live in self._live.values():
            live.request_stop("stopped: the service was shut down")

    async def shut_down(self, timeout_s: float = 20.0) -> None:
        """Stop every run and wait until its valve is safe and its end is stored."""
        self.begin_shutdown()
        if self._tasks:
            _, late = await asyncio.wait(set(self._tasks), timeout=timeout_s)
            for task in late:
                _LOG.error("a test did not end in time", seconds=timeout_s)
                task.cancel()
            if late:  # what is cancelled still sends its valve to safe
                await asyncio.wait(late, timeout=_CANCELLED_S)
