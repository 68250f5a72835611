"""Runs: asked for, watched, stopped, and brought to an end when the service ends."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Any, Final

import structlog

from service.audit.log import AuditLog
from service.events import Event
from service.runs.acknowledgement import acknowledged, ended_badly
from service.runs.analyst import Analyst
from service.runs.gate import Gate
from service.runs.life import Life, OnSamples
from service.runs.live import LiveRun, LiveRuns
from service.runs.permission import Permission
from service.runs.recovery import Recovery
from service.runs.requester import LOCAL, Requester
from service.runs.rig import Order, Rig
from service.runs.run import Label, Run, checked_run_id, new_run_id
from service.runs.separating import SEPARATING, check_name, separating_of
from service.runs.sequences import choose_waveform
from service.runs.tasks import Tasks
from service.settings import Plant, PlantValve
from service.store.store import Store
from valve.errors import BusyError, ElsewhereError, NotFoundError, RequestError

_LOG = structlog.get_logger(__name__)
_STORE_AGAIN_S: Final = 2.0  # a look at the disk costs nothing, and somebody may be freeing it


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
        self._gate = Gate(plant, store, rig)
        self._live = LiveRuns()
        self._tasks = Tasks()
        self._closing = False

    def valve(self, tag: str) -> PlantValve:
        """Return the valve of this tag. Raises NotFoundError."""
        if tag not in self._plant.valves:
            raise NotFoundError(f"valve {tag[:64]!r} is unknown: GET /valves lists all")
        return self._plant.valves[tag]

    def user_of(self, tag: str) -> str | None:
        """Return the id of the run that uses this valve now, if any."""
        return self._gate.owners.holder(tag)

    def why_not_scheduled(self, tag: str) -> str:
        """Return why a scheduled test of a valve has to wait now; "" where it may start."""
        return self._gate.owners.why_not_scheduled(tag, self.valve(tag).buses)

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
        if sequence is not None:
            check_name(sequence)
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
        async with self._gate.turn(valve):
            known = await self._asked_before(wanted)
            if known is not None:
                return known
            if self._closing:
                raise BusyError(f"{tag}: the service is shutting down: repeat the request when it is back")
            stored, claim = await self._gate.admit(wanted, valve, permit)
            live = self._live.begin(stored)
            order = Order(valve, choice.waveform, choice.name, stored.number, permit)
            life = Life(
                live,
                order,
                claim,
                self._store,
                self._gate.owners,
                audit=self._audit,
                together=together,
                on_samples=self._on_samples,
            )
            self._tasks.spawn(self._carry_out(life, live))
        because = {"because": choice.reason} if choice.reason else {}
        _LOG.info("test accepted", test=stored.id, valve=tag, sequence=choice.name, run_number=stored.number, **because)
        return live.run

    async def _carry_out(self, life: Life, live: LiveRun) -> None:
        """Let a test run to its end; an end that the store could not take is stored as soon as it can be.

        Until then the next start would know nothing of a bad end, and the disk alone would bar it.
        """
        await life.run(self._rig, self._analyst)
        while not life.is_end_stored and not self._closing:
            await asyncio.sleep(_STORE_AGAIN_S)
            try:
                await asyncio.to_thread(self._store.runs.save, live.run)
            except Exception as error:  # noqa: BLE001  - whatever the store lacks now it may have later
                _LOG.warning("end of test still not stored", test=live.run.id, error=str(error))
            else:
                life.is_end_stored = True
                _LOG.warning("end of test stored late", test=live.run.id)

    async def permission(self, tag: str, permit: str | None = None) -> tuple[Permission | None, str]:
        """Return what must hold before this valve may move, read fresh without moving it, and why it is not fresh.

        ``permit`` is the work permit that a test would name, where the valve demands one.
        While a bus of it is used the last ones are returned (None where there are none) with the reason.
        Raises NotFoundError, ElsewhereError.
        """
        valve = self.valve(tag)
        self._check_gateway(tag)
        return await self._gate.permission(valve, permit)

    async def acknowledge(self, run_id: str, requester: Requester, note: str) -> Run:
        """Note that somebody looked at the valve after a test that ended badly; the first note stays.

        Raises NotFoundError, and RequestError where there is nothing to acknowledge or the test still runs.
        """
        run = await self.get(run_id)
        if run.acknowledged_at is not None:
            return run
        if not ended_badly(run):
            raise RequestError(f"test {run.id} is {run.state.value} and needs no acknowledgement: nothing to do")
        live = self._live.find(run.id)
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
        known = await self._gate.known(wanted)
        return None if known is None else await self.get(known.id)

    async def get(self, run_id: str) -> Run:
        """Return a run as it stands now. Raises NotFoundError."""
        live = self._live.find(checked_run_id(run_id))
        return await asyncio.to_thread(self._store.runs.get, run_id) if live is None else live.run

    async def newest(self, limit: int, *, before: str | None = None, tag: str | None = None) -> list[Run]:
        """Runs older than the run ``before``, newest first. Raises NotFoundError."""
        number = None if before is None else (await self.get(before)).number
        runs = await asyncio.to_thread(self._store.runs.newest, limit, before=number, valve=tag)
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

    async def rest(self, run_id: str) -> None:
        """Return when the valve of a run moves no more."""
        live = self._live.find(run_id)
        if live is not None:
            await live.motion_ended.wait()

    async def stop(self, run_id: str, *, reason: str = "stopped on request", timeout_s: float = 8.0) -> Run:
        """Send the valve of a run to safe at once and return when it is there; what has ended stays as it is."""
        live = self._live.find(checked_run_id(run_id))
        if live is not None:
            live.request_stop(reason)
            try:
                await asyncio.wait_for(live.motion_ended.wait(), timeout_s)
            except TimeoutError:
                _LOG.error("stop takes long", test=run_id, seconds=timeout_s)
        return await self.get(run_id)

    async def follow(self, run_id: str, after: int) -> AsyncIterator[tuple[Event, ...]]:
        """Return the events of a run with an id above ``after``, as ``EventLog.follow``. Raises NotFoundError."""
        live = self._live.find(checked_run_id(run_id))
        if live is None:
            live = LiveRun(await asyncio.to_thread(self._store.runs.get, run_id))
        return live.events.follow(after)

    async def recover(self) -> None:
        """Send the valves that a dead process left to safe and mark its tests; returns when they are marked."""
        await Recovery(self._plant, self._store, self._rig, self._gate, self._tasks, audit=self._audit).begin()

    async def settled(self) -> None:
        """Return when everything that this process has under way, recovery included, has come to its end."""
        await self._tasks.settled()

    def begin_shutdown(self) -> None:
        """Accept no further test and stop those that run."""
        self._closing = True
        for live in self._live:
            live.request_stop("stopped: the service was shut down")

    async def shut_down(self, timeout_s: float = 20.0) -> None:
        """Stop every run and wait until its valve is safe and its end is stored."""
        self.begin_shutdown()
        await self._tasks.end(timeout_s)
