"""What stands between a request and a valve: one test a bus, what must hold before it moves, and its intent on disk."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime

import structlog

from drivers.motion.orders import MotionLink, MotionLostError
from drivers.motion.plant_read import valve_read
from drivers.permissive import require_met
from service.config.plant import Plant, PlantValve
from service.model.acknowledgement import last_end
from service.model.run import Run
from service.runs.bus_owners import BusOwners, Claim
from service.runs.permission import Permission, free_disk
from service.store.store import Store
from valve.errors import BusyError, PermissiveError, RequestError
from valve.messages import message_of, say

_LOG = structlog.get_logger(__name__)


@contextlib.contextmanager
def _refusals_logged(wanted: Run) -> Iterator[None]:
    """Leave a line where a person's test is refused; a scheduled one is tried again and says how that ended."""
    try:
        yield
    except (BusyError, PermissiveError) as error:
        if wanted.schedule is None:
            by = wanted.requested_by
            _LOG.warning("test refused", valve=wanted.valve, sequence=wanted.sequence, by=by, reason=str(error))
        raise


class Admission:
    """Lets tests in, one a bus. ``owners`` says who uses which valve. All methods belong to the event loop."""

    def __init__(self, plant: Plant, store: Store, motion: MotionLink) -> None:
        self._plant = plant
        self._store = store
        self._motion = motion
        self.owners = BusOwners(locks=motion)
        self._bus_turns = {name: asyncio.Lock() for name in plant.buses}
        self._permissions: dict[str, Permission] = {}  # as they were read last, by tag
        self._storing = asyncio.Lock()

    def add_buses(self, names: Iterable[str]) -> None:
        """Know buses that a reload has added; their addresses come with the plant's."""
        for name in names:
            self._bus_turns.setdefault(name, asyncio.Lock())

    @contextlib.asynccontextmanager
    async def turn(self, valve: PlantValve) -> AsyncIterator[None]:
        """Wait for the buses of a valve as long as somebody only reads there; a test that runs is not waited for."""
        async with contextlib.AsyncExitStack() as stack:
            for bus in sorted(valve.buses):
                await stack.enter_async_context(self._bus_turns[bus])
            yield

    async def known(self, wanted: Run, permit: str | None) -> Run | None:
        """Return the stored run that a request's key asked for first; None where the request is new.

        Raises RequestError where that key asked for something else.
        """
        if wanted.idempotency_key is None:
            return None
        known = await asyncio.to_thread(self._store.runs.by_idempotency_key, wanted.idempotency_key)
        if known is None:
            return None
        was = (known.valve, known.sequence, known.overrides, known.label, (known.permissives or {}).get("permit"))
        if was != (wanted.valve, wanted.sequence, wanted.overrides, wanted.label, permit):
            raise RequestError(
                say(
                    "key_used",
                    "Idempotency-Key {key} was used for another request (test {test}): choose a new key for a new test",
                    key=repr(wanted.idempotency_key),
                    test=known.id,
                )
            )
        return known

    async def admit(self, wanted: Run, valve: PlantValve, permit: str | None) -> tuple[Run, Claim]:
        """Claim the valve and store the run that is wanted, in the caller's ``turn``; return it as stored.

        Raises BusyError, PermissiveError and RequestError; then nothing is stored and nothing is claimed.
        """
        with _refusals_logged(wanted):
            return await self._admitted(wanted, valve, permit)

    async def _admitted(self, wanted: Run, valve: PlantValve, permit: str | None) -> tuple[Run, Claim]:
        claim = self.owners.claim(wanted.id, wanted.valve, valve.buses, scheduled=wanted.schedule is not None)
        try:
            await self.owners.lock(claim)
            permission = await self._read_permission(valve, permit)
            require_met(wanted.valve, permission.permissives)
            async with self._storing:
                known = await self.known(wanted, permit)  # of another valve, meanwhile: then it is refused
                assert known is None
                wanted = replace(wanted, permissives=permission.to_json())
                return await asyncio.to_thread(self._store.runs.insert, wanted), claim
        except BaseException:
            self.owners.release(claim)
            raise

    async def claim_when_free(self, run: Run, valve: PlantValve) -> Claim:
        """Claim the valve of a run that was admitted before; wait for as long as somebody else uses it."""
        while True:
            try:
                async with self.turn(valve):
                    claim = self.owners.claim(run.id, run.valve, valve.buses)
                    try:
                        await self.owners.lock(claim)
                    except MotionLostError:  # it is kept in this process, and asked for again by whoever uses it
                        return claim
                    except BaseException:
                        self.owners.release(claim)
                        raise
                    return claim
            except BusyError:
                await asyncio.sleep(0.05)

    async def permission(self, valve: PlantValve, permit: str | None) -> tuple[Permission | None, str]:
        """Return what must hold before a valve may move, read fresh, and why it is not fresh.

        While a bus of it is used the last ones are returned (None where there are none) with the reason.
        """
        tag = valve.nameplate.tag
        async with self.turn(valve):
            in_use = self.owners.in_use(tag, valve.buses)
            if in_use:
                return self._permissions.get(tag), in_use
            try:
                async with self._motion.hold(valve.buses):
                    return await self._read_permission(valve, permit), ""
            except BusyError as error:
                return self._permissions.get(tag), message_of(error)

    async def _read_permission(self, valve: PlantValve, permit: str | None) -> Permission:
        read = valve_read(valve.wiring, self._plant.buses)
        found = await self._motion.permissives(valve.nameplate.tag, permit, read)
        last = await asyncio.to_thread(self._store.runs.newest, 1, valve=valve.nameplate.tag)
        disk = await asyncio.to_thread(free_disk, self._store.folder)
        permission = Permission((*found, disk, last_end(last[0] if last else None)), datetime.now(UTC), permit)
        self._permissions[valve.nameplate.tag] = permission
        return permission
