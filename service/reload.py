"""plant.toml read again while the service serves: valves, groups and schedules change, and a valve under test does not.

A file with a fault changes nothing. What the process was started with (where it listens, its store, who may reach it,
its broker, the address of a bus that it has) stays as it is until the next start, and is told.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Final, TypeVar

import structlog
from pydantic import BaseModel, Field

from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink, MotionLostError
from service.config.plant import Plant, PlantValve
from service.config.settings import faults_of
from service.runs.service import Runs
from valve.errors import ConfigurationError, RequestError, ValveError
from valve.messages import Message, joined, say

_LOG = structlog.get_logger(__name__)
_NOTHING_CHANGED: Final = say("file_has_not_changed", "nothing has changed: correct the file and reload it again")
_LOOK_S: Final = 0.1  # how often it is looked whether a test has ended whose valve was changed
_LIVE: Final = ("zone",)  # of [service]
_Value = TypeVar("_Value")


class Changed(BaseModel):
    """What a reload changed among things of one kind, by their names."""

    added: list[str]
    changed: list[str]
    removed: list[str]


class Reloaded(BaseModel):
    """What a reload did."""

    valves: Changed
    schedules: Changed
    buses_added: list[str]
    waiting: list[str] = Field(description="valves under test: each keeps its former configuration until its test ends")
    needs_restart: list[str] = Field(description="what the file says otherwise and the service keeps until it restarts")


class Reloader:
    """Takes a changed plant file over. All methods belong to the event loop.

    ``tell`` are called after each change: those who made something of the plant read it anew.
    """

    def __init__(
        self, plant: Plant, runs: Runs, motion: MotionLink, audit: AuditLog, tell: Sequence[Callable[[], None]]
    ) -> None:
        self._plant, self._runs, self._motion, self._audit = plant, runs, motion, audit
        self._tell_each = tell
        self._one_at_a_time = asyncio.Lock()
        self._waiting: dict[str, PlantValve | None] = {}  # what a valve under test will be; None: it goes
        self._settling: asyncio.Task[None] | None = None
        self._by_signal: asyncio.Task[None] | None = None

    async def reload(self, who: str) -> Reloaded:
        """Read the file again and take it over. Raises RequestError with every fault; then nothing has changed."""
        plant = self._plant
        async with self._one_at_a_time:
            fresh, faults = await asyncio.to_thread(faults_of, plant.file)
            refused: list[str] = [fault.message for fault in faults]
            if fresh is not None:
                refused += _moved_buses(plant, fresh)
            if refused or fresh is None:
                note = {"faults": refused[:100]}
                await asyncio.to_thread(self._audit.append, "plant.reload_refused", who=who, details=note)
                _LOG.warning("plant file not taken over: nothing has changed", faults=refused)
                raise RequestError(joined("; ", [*refused, _NOTHING_CHANGED]))
            told = self._told(fresh)
            await asyncio.to_thread(self._audit.append, "plant.reloaded", who=who, details=told.model_dump())
            told.waiting = self._take_over(fresh)
            await self._tell_motion()
        _LOG.info("plant file taken over", **told.model_dump())
        return told

    def _told(self, fresh: Plant) -> Reloaded:
        plant = self._plant
        standing = {**plant.valves, **{tag: valve for tag, valve in self._waiting.items() if valve is not None}}
        for tag in [tag for tag, valve in self._waiting.items() if valve is None]:
            standing.pop(tag, None)
        valves = _changed(standing, fresh.valves)
        schedules = _changed({one.name: one for one in plant.schedules}, {one.name: one for one in fresh.schedules})
        waiting = [tag for tag in (*valves.changed, *valves.removed) if self._runs.user_of(tag) is not None]
        added = sorted(set(fresh.buses) - set(plant.buses))
        kept = _kept(plant, fresh)
        if fresh.schedules and not plant.schedules:
            kept.append("schedules (the first one)")
            schedules = Changed(added=[], changed=[], removed=[])
        return Reloaded(valves=valves, schedules=schedules, buses_added=added, waiting=waiting, needs_restart=kept)

    def _take_over(self, fresh: Plant) -> list[str]:
        """Change the plant in one go: nothing else runs on the event loop meanwhile. Return the valves that wait."""
        plant = self._plant
        under_test = {tag: valve for tag, valve in plant.valves.items() if self._runs.user_of(tag) is not None}
        self._waiting = {
            tag: fresh.valves.get(tag) for tag, valve in under_test.items() if fresh.valves.get(tag) != valve
        }
        self._runs.add_buses({name: one for name, one in fresh.buses.items() if name not in plant.buses})
        plant.take_over(fresh, {tag: under_test[tag] for tag in self._waiting})
        self._tell()
        if self._waiting and (self._settling is None or self._settling.done()):
            self._settling = asyncio.create_task(self._settle())
        return sorted(self._waiting)

    async def _settle(self) -> None:
        """Give each valve its new configuration as soon as its test has ended."""
        while self._waiting:
            await asyncio.sleep(_LOOK_S)
            for tag in [tag for tag in self._waiting if self._runs.user_of(tag) is None]:
                self._plant.set_valve(tag, self._waiting.pop(tag))
                self._tell()
                await self._settle_in_motion(tag)
                _LOG.info("valve has its new configuration", valve=tag)

    async def _tell_motion(self) -> None:
        """Have the motion process read the file, too, but for the valves that wait; one that starts later reads it."""
        try:
            await self._motion.reload(self._waiting)
        except (MotionLostError, ConfigurationError) as error:
            _LOG.error("motion process has not read the plant file: reload it again", reason=str(error))

    async def _settle_in_motion(self, tag: str) -> None:
        try:
            await self._motion.settled(tag)
        except MotionLostError as error:
            _LOG.warning("motion process has not read the plant file", reason=str(error))

    def _tell(self) -> None:
        """Have those read the plant anew who made something of it."""
        for tell in self._tell_each:
            tell()

    async def close(self) -> None:
        """Wait for no test any more: the next start reads the file."""
        if self._settling is not None:
            self._settling.cancel()
            await asyncio.wait({self._settling})

    def on_signal(self) -> None:
        """Reload for SIGHUP, in a task of its own; what is wrong is in the log."""
        self._by_signal = asyncio.create_task(self._reload_by_signal())

    async def _reload_by_signal(self) -> None:
        try:
            await self.reload("SIGHUP")
        except RequestError:
            pass  # it is logged, with every fault
        except ValveError as error:
            _LOG.error("plant file not taken over: nothing has changed", error=str(error))


def _changed(was: Mapping[str, _Value], now: Mapping[str, _Value]) -> Changed:
    return Changed(
        added=[name for name in now if name not in was],
        changed=[name for name in now if name in was and now[name] != was[name]],
        removed=[name for name in was if name not in now],
    )


def _moved_buses(plant: Plant, fresh: Plant) -> list[Message]:
    """Say which buses have another address or gateway: a device id means another device there, so nothing is mixed."""
    moved = [
        name
        for name, address in fresh.buses.items()
        if name in plant.buses
        and (address != plant.buses[name] or fresh.bus_gateways.get(name) != plant.bus_gateways.get(name))
    ]
    return [
        say(
            "bus_was_changed",
            "{file}: bus {bus} was changed: that needs a restart, or another name",
            file=plant.file.name,
            bus=name,
        )
        for name in moved
    ]


def _kept(plant: Plant, fresh: Plant) -> list[str]:
    """Return the keys that the file says otherwise and a running service cannot change."""
    service = plant.service
    kept = [
        f"service.{one.name}"
        for one in fields(service)
        if one.name not in (*_LIVE, "access") and getattr(fresh.service, one.name) != getattr(service, one.name)
    ]
    approved = replace(fresh.service.access, approved_sequences=service.access.approved_sequences)
    if approved != service.access:
        kept.append("service: who may reach it (access, TLS, proxy, hosts)")
    kept += [name for name in ("mqtt", "gateways") if getattr(fresh, name) != getattr(plant, name)]
    return kept
