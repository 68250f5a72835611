"""A simulated plant: valves, the units that show and move them, and the wires that the units are served on."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from drivers.maps import reference
from drivers.register_map import RegisterMap
from drivers.registers import Register
from simulator.bus import Bus
from simulator.clock import Clock, RunningClock
from simulator.faults import Fault
from simulator.gauge import Gauge, GaugeListener
from simulator.listeners import Listener
from simulator.plant import SoftwareValve, warm_up
from simulator.record import ValveRecord
from simulator.reference_unit import ReferenceUnit
from simulator.samples import EndedRecord
from simulator.simulated_valve import SimulatedValve
from simulator.slave import Slave
from simulator.unit import Channel, MapUnit, Quantity, Unit
from valve.errors import ConfigurationError, NotFoundError
from valve.messages import joined, say


@dataclass(frozen=True, slots=True)
class SimulatedChannel:
    """One register and the valve, by tag, that it shows or moves; ``register`` is scaled to Pa or m."""

    tag: str
    quantity: Quantity
    register: Register


@dataclass(frozen=True, slots=True)
class SimulatedUnit:
    """One device id: its map and its channels; several valves may share it, a valve may be spread over several."""

    device_id: int
    map: RegisterMap
    channels: tuple[SimulatedChannel, ...]


def reference_unit(device_id: int, tag: str, *, pressure: bool = True) -> SimulatedUnit:
    """Return a device with the reference map that serves one valve alone."""
    quantities = [Quantity.COMMAND, Quantity.POSITION, *([Quantity.PRESSURE] if pressure else [])]
    channels = (SimulatedChannel(tag, quantity, reference.MAP.register(quantity)) for quantity in quantities)
    return SimulatedUnit(device_id, reference.MAP, tuple(channels))


def warm_up_for(valves: Sequence[SimulatedValve]) -> None:
    """Compile, or load, what follows these valves' stems."""
    warm_up(
        effects=any(settings.effects and not settings.is_packed for settings in valves),
        packing=any(settings.is_packed for settings in valves),
    )


class SimulatedPlant:
    """Valves on wires, from ``start`` to ``stop``; ``valves`` and ``records`` are theirs by tag.

    A gauge shows the position of the valve whose tag stands beside it.

    Raises ConfigurationError where units and valves do not fit together.
    """

    def __init__(
        self,
        valves: Sequence[SimulatedValve],
        listeners: Mapping[Listener, Sequence[SimulatedUnit]],
        clock: Clock | None = None,
        gauges: Mapping[GaugeListener, str] | None = None,
    ) -> None:
        warm_up_for(valves)
        self.clock = RunningClock() if clock is None else clock
        self._valves: dict[str, SoftwareValve] = {}
        for settings in valves:
            if settings.tag in self._valves:
                raise ConfigurationError(
                    say(
                        "simulated_twice",
                        "valve {tag} stands in the simulated plant twice, rename one",
                        tag=settings.tag,
                    )
                )
            self._valves[settings.tag] = SoftwareValve(settings, self.clock.now_s())
        self.valves: Mapping[str, SoftwareValve] = MappingProxyType(self._valves)
        self.slaves = [
            Slave(listener, Bus([self._unit(unit) for unit in units], self.clock.now_s))
            for listener, units in listeners.items()
        ]
        self._described = [
            joined(
                "; ",
                [
                    say(
                        "unit_of_valves",
                        "unit {unit} ({map}) {valves:, }",
                        unit=unit.device_id,
                        map=unit.map.name,
                        valves=tuple(dict.fromkeys(channel.tag for channel in unit.channels)),
                    )
                    for unit in units
                ],
            )
            for units in listeners.values()
        ]
        self.gauges = [
            Gauge(listener, self._known(tag, str(listener.link_path)), self.clock.now_s)
            for listener, tag in (gauges or {}).items()
        ]
        self._served: list[Slave | Gauge] = [*self.slaves, *self.gauges]
        self.addresses: list[str] = []
        self._watching: asyncio.Task[None] | None = None

    @property
    def records(self) -> dict[str, ValveRecord]:
        """What happened to each valve, by tag."""
        return {tag: valve.record for tag, valve in self._valves.items()}

    @property
    def descriptions(self) -> list[str]:
        """What is served, in words: one entry a listener, in the order of ``addresses``."""
        return [*self._described, *(say("gauge_of_valve", "gauge of {tag}", tag=gauge.tag) for gauge in self.gauges)]

    async def start(self, look_every_s: float | None = None) -> None:
        """Serve every listener; ``addresses`` then has one entry a listener, in their order, gauges last.

        With ``look_every_s`` every valve is also looked at so often (real time), so that its record goes on where
        nobody reads and the first read need not wait for all that was. Raises ConfigurationError where an address
        cannot be had; then nothing is served.
        """
        try:
            for served in self._served:
                self.addresses.append(await served.start())
        except ConfigurationError:
            await self.stop()
            raise
        if look_every_s is not None:
            self._watching = asyncio.get_running_loop().create_task(self._watch(look_every_s))

    async def stop(self) -> None:
        """Stop serving."""
        if self._watching is not None:
            self._watching.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._watching
            self._watching = None
        for served in self._served:
            await served.stop()
        self.addresses = []

    def look(self) -> None:
        """Bring every valve to the present time."""
        now_s = self.clock.now_s()
        for valve in self._valves.values():
            valve.look(now_s)

    def inject(self, tag: str, fault: Fault) -> None:
        """Add a fault to a valve or its device. Raises NotFoundError, or ParameterError for one in the past."""
        if tag not in self._valves:
            raise NotFoundError(
                say(
                    "not_simulated",
                    "valve {tag} is not in the simulated plant; there are {valves:, }",
                    tag=tag,
                    valves=tuple(self._valves),
                )
            )
        self._valves[tag].inject(fault)

    async def _watch(self, every_s: float) -> None:
        while True:
            for valve in self._valves.values():
                valve.look(self.clock.now_s())
                await asyncio.sleep(0.0)  # who reads need not wait for all valves
            await asyncio.sleep(every_s)

    def tell_of_records(self, tell: Callable[[str, EndedRecord], None]) -> None:
        """Call ``tell`` with the tag and the truth of each record that ends from now on."""
        for valve in self._valves.values():
            valve.on_record = tell

    def _known(self, tag: str, subject: str) -> SoftwareValve:
        if tag not in self._valves:
            raise ConfigurationError(
                say(
                    "unit_of_unsimulated_valve",
                    "{subject}: valve {tag} is not in the simulated plant",
                    subject=subject,
                    tag=tag,
                )
            )
        return self._valves[tag]

    def _unit(self, unit: SimulatedUnit) -> Unit:
        subject = say("unit_named", "unit {unit}", unit=unit.device_id)
        if unit.map.name != reference.MAP.name:
            channels = [Channel(c.register, c.quantity, self._known(c.tag, subject)) for c in unit.channels]
            return MapUnit(unit.device_id, unit.map, channels)
        by_quantity: dict[Quantity, SoftwareValve] = {}
        for channel in unit.channels:
            if channel.quantity in by_quantity:
                raise ConfigurationError(
                    say(
                        "unit_quantity_twice",
                        "unit {unit}: two valves have their {quantity} there, the reference map has one: give each "
                        "valve a device id of its own",
                        unit=unit.device_id,
                        quantity=channel.quantity,
                    )
                )
            by_quantity[channel.quantity] = self._known(channel.tag, subject)
        if Quantity.COMMAND not in by_quantity:
            raise ConfigurationError(
                say(
                    "unit_without_command",
                    "unit {unit}: no valve is commanded there, the reference map needs one",
                    unit=unit.device_id,
                )
            )
        return ReferenceUnit(
            unit.device_id,
            by_quantity[Quantity.COMMAND],
            position=by_quantity.get(Quantity.POSITION),
            pressure=by_quantity.get(Quantity.PRESSURE),
            speed=self.clock.speed,
        )
