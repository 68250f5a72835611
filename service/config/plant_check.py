"""What the devices of a plant show before a service is started: every one is read, none is written to."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any, Final

from drivers.inspection import Inspector, ValveSeen, read_only_bus
from drivers.motion.bus_lock import BusLocks
from service.config.plant import Plant, PlantValve
from service.model.sequences import build_waveform, default_of
from valve.errors import ValveError
from valve.messages import message_of
from valve.waveform import Waveform

_AT_A_TIME: Final = 64  # buses that are being opened: each is a socket and a deadline


@dataclass(frozen=True, slots=True)
class CheckedValve:
    """A valve as it was seen. ``elsewhere`` names the gateway that reaches it, "" where it is this one."""

    tag: str
    travel_m: float
    seen: ValveSeen | None
    elsewhere: str = ""

    @property
    def is_right(self) -> bool:
        """Whether nothing stands against a test of it, as far as this gateway can tell."""
        return self.seen is None or not self.seen.faults

    @property
    def position_percent(self) -> float | None:
        """Stem position in percent of the rated travel."""
        position_m = None if self.seen is None else self.seen.position_m
        return None if position_m is None else 100.0 * position_m / self.travel_m

    def to_json(self) -> dict[str, Any]:
        """Return it for machines: SI units, null for what nothing shows."""
        about: dict[str, Any] = {"tag": self.tag, "right": self.is_right, "elsewhere": self.elsewhere or None}
        seen = self.seen
        if seen is None:
            return about
        devices = [
            {"subject": one.subject, "map": one.map, "number": one.number, "answers": not one.fault, "fault": one.fault}
            for one in seen.devices
        ]
        return {
            **about,
            "devices": devices,
            "output_pa": seen.output_pa,
            "position_m": seen.position_m,
            "position_percent": self.position_percent,
            "pressure_pa": seen.pressure_pa,
            "supply_pa": seen.supply_pa,
            "loop_in_manual": seen.loop_in_manual,
            "interlock": seen.interlock,
            "owner": seen.owner,
            "watchdog": seen.watchdog,
            "permissives": [one.to_json() for one in seen.permissives],
            "faults": list(seen.faults),
        }


async def look_at_plant(plant: Plant) -> AsyncIterator[CheckedValve]:
    """Look at every valve that this gateway drives, all buses at the same time; yields them in the file's order.

    A bus that another process uses, or that cannot be opened, is told with each valve on it, and the others are read.
    """
    ours = [tag for tag in plant.valves if plant.is_ours(tag)]
    needed = sorted({bus for tag in ours for bus in plant.valves[tag].buses})
    async with AsyncExitStack() as stack:
        locks = BusLocks(plant.buses)
        stack.callback(locks.give_back, needed)
        buses = {name: read_only_bus(plant.buses[name]) for name in needed}
        unopened: dict[str, str] = {}
        places = asyncio.Semaphore(_AT_A_TIME)

        async def opened(name: str) -> None:
            stack.push_async_callback(buses[name].close)
            try:
                locks.take([name])
                async with places:
                    await buses[name].open()
            except ValveError as error:
                unopened[name] = message_of(error)

        await asyncio.gather(*map(opened, needed))
        inspector = Inspector(buses, unopened)
        looks = {
            tag: asyncio.ensure_future(inspector.look(plant.valves[tag].wiring, _waveforms(plant, plant.valves[tag])))
            for tag in ours
        }
        try:
            for tag, valve in plant.valves.items():
                travel_m = valve.nameplate.actuator.travel_m
                if tag in looks:
                    yield CheckedValve(tag, travel_m, await looks[tag])
                else:
                    yield CheckedValve(tag, travel_m, None, plant.gateway_of(tag))
        finally:
            for look in looks.values():
                look.cancel()
            await asyncio.gather(*looks.values(), return_exceptions=True)


def _waveforms(plant: Plant, valve: PlantValve) -> list[Waveform]:
    """Return what a test without a name and every scheduled check of a valve play."""
    nameplate, limits = valve.nameplate, valve.wiring.limits
    name, _ = default_of(nameplate, limits)
    wanted: list[tuple[str, Mapping[str, Any]]] = [] if name is None else [(name, {})]
    wanted += [(one.sequence, one.overrides) for one in plant.schedules if nameplate.tag in one.valves]
    return [build_waveform(name, overrides, nameplate, limits) for name, overrides in wanted]
