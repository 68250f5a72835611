"""Looking at a wired valve without writing: who answers, what is shown, and what keeps a test from starting."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NoReturn, TypeAlias, TypeVar

from drivers.addresses import BusAddress, GaugeAddress, Mode, ValveWiring
from drivers.bus import Bus, Gauge
from drivers.course import Course
from drivers.crc import words_crc16
from drivers.device import ValveDevice
from drivers.identity import require_identity
from drivers.permissive import Permissive, missing_words
from drivers.permissives import read_permissives
from drivers.registers import Block
from drivers.serial_gauge import SerialGauge
from drivers.transport import Transport
from drivers.wiring import Signal, Unit, Wired, WiredContact, read_blocks, wire
from valve.errors import EquipmentError, InternalError, WaveformError
from valve.messages import message_of, say
from valve.waveform import Waveform

_Value = TypeVar("_Value")
_Key: TypeAlias = tuple[str, int, str]  # bus, device id, map
#: Stands for the number that whoever starts a test will name.
_PERMIT = say("named_at_each_start", "named at the start of each test")


class ReadOnlyTransport(Transport):
    """A Modbus bus on which nothing can be written, whoever asks."""

    async def write(self, *_: object, **__: object) -> NoReturn:
        """Refuse."""
        raise InternalError(
            say(
                "check_wanted_to_write",
                "bus {bus}: a check wanted to write, which it never may: report it",
                bus=self.name,
            )
        )

    read_write = write


def read_only_bus(address: BusAddress) -> Bus:
    """Return the bus at an address, on which nothing can be written; nothing is opened."""
    return SerialGauge(address) if isinstance(address, GaugeAddress) else ReadOnlyTransport(address)


@dataclass(frozen=True, slots=True)
class DeviceSeen:
    """One device or gauge of a valve. ``fault`` is "" where it answers as the one that is configured."""

    subject: str
    map: str | None
    number: int | None = None
    fault: str = ""


@dataclass(frozen=True, slots=True)
class ValveSeen:
    """What a valve shows: Pa and m, None for what nothing shows or could not be read.

    ``watchdog`` is off, armed or tripped. ``faults`` are sentences, one for everything that is not right; permissives
    are judged only where all devices answer.
    """

    tag: str
    devices: tuple[DeviceSeen, ...]
    output_pa: float | None = None
    position_m: float | None = None
    pressure_pa: float | None = None
    supply_pa: float | None = None
    loop_in_manual: bool | None = None
    interlock: bool | None = None
    owner: int | None = None
    watchdog: str | None = None
    permissives: tuple[Permissive, ...] = ()
    faults: tuple[str, ...] = ()


class Inspector:
    """Looks at valves that share buses; each device is asked once who it is, however many valves it serves.

    ``unopened`` tells of buses that could not be opened, by name, why.
    """

    def __init__(self, buses: Mapping[str, Bus], unopened: Mapping[str, str]) -> None:
        self._buses = buses
        self._unopened = unopened
        self._identities: dict[_Key, asyncio.Task[DeviceSeen]] = {}

    async def look(self, wiring: ValveWiring, waveforms: Sequence[Waveform] = ()) -> ValveSeen:
        """Look at one valve; ``waveforms`` are what its tests play, which a device that captures must have room for.

        Raises ConfigurationError where the wiring contradicts itself; all else is told in what is returned.
        """
        wired = wire(wiring, self._buses)
        units = {_key(unit): unit for unit in _units(wired)}
        asked = await asyncio.gather(*(self._identity(unit) for unit in units.values()))
        seen = dict(zip(units, asked, strict=True))
        look = _Look(wiring, wired, seen)
        if not isinstance(wired.position, Signal):
            await look.at_gauge(wired.position, self._unopened.get(wired.position.name, ""))
        return await look.result(waveforms)

    async def _identity(self, unit: Unit) -> DeviceSeen:
        key = _key(unit)
        if key not in self._identities:
            self._identities[key] = asyncio.ensure_future(self._asked(unit))
        return await self._identities[key]

    async def _asked(self, unit: Unit) -> DeviceSeen:
        subject, name, number = unit.subject, unit.map.name, None
        fault = self._unopened.get(unit.bus.name, "")
        try:
            if not fault:
                await require_identity(say("bus_named", "bus {bus}", bus=unit.bus.name), unit)
                if unit.map.canary is None:  # nothing proves who it is; any register shows that it answers
                    await unit.value(unit.map.registers[0].name)
                if unit.map.number is not None:
                    number = round(await unit.value(unit.map.number))
        except EquipmentError as error:
            fault = message_of(error)
        return DeviceSeen(subject, name, number, fault)


def _key(unit: Unit) -> _Key:
    return unit.bus.name, unit.device_id, unit.map.name


def _units(wired: Wired) -> list[Unit]:
    """Every device that a test of the valve asks."""
    places = (wired.manual, wired.interlock, wired.supply)
    return [*wired.units, *(place.unit for place in places if place is not None)]


class _Look:
    """One look at one valve, piece by piece: what cannot be read is a fault, and the rest is read all the same."""

    def __init__(self, wiring: ValveWiring, wired: Wired, seen: dict[_Key, DeviceSeen]) -> None:
        self._wiring = wiring
        self._wired = wired
        self._seen = seen
        self._devices = list(seen.values())
        self._position_m: float | None = None
        self._values: dict[_Key, dict[str, float]] = {}  # by device and register
        self._faults = list(dict.fromkeys(device.fault for device in self._devices if device.fault))

    def _answers(self, unit: Unit) -> bool:
        return not self._seen[_key(unit)].fault

    async def _tried(self, unit: Unit, reading: Callable[[], Awaitable[_Value]]) -> _Value | None:
        """Return what a device says; None where it does not answer, or not to this."""
        if not self._answers(unit):
            return None
        try:
            return await reading()
        except EquipmentError as error:
            self._faults.append(message_of(error))
            return None

    async def at_gauge(self, gauge: Gauge, closed: str) -> None:
        """Ask the gauge, where its line is open."""
        fault = closed
        try:
            if not fault:
                self._position_m = (await gauge.read()).value_m
        except EquipmentError as error:
            fault = message_of(error)
        self._devices.append(DeviceSeen(say("gauge_named", "gauge {gauge}", gauge=gauge.name), None, fault=fault))
        if fault:
            self._faults.append(fault)

    async def _read(self) -> None:
        """Read what each device measures, in the same transactions as a test does."""
        wired = self._wired
        signals = [s for s in (wired.readback, wired.position, wired.pressure, wired.supply) if isinstance(s, Signal)]
        for unit in {_key(unit): unit for unit in _units(wired)}.values():
            values = self._values[_key(unit)] = {}
            registers = [signal.register for signal in signals if _key(signal.unit) == _key(unit)]
            for block in read_blocks(unit, registers):
                exchange = await self._tried(unit, partial(unit.bus.read, unit.device_id, block))
                if exchange is not None:
                    values |= block.decode(exchange.words)
                    self._check_live(unit, block, exchange.words)

        for unit, name in self._measured():
            status = await self._tried(unit, partial(unit.value, unit.map.statuses[name]))
            if status:
                register = unit.map.register(unit.map.statuses[name])
                self._faults.append(
                    say(
                        "signal_beyond_range",
                        "{device}: {signal} shows {status:g} ({meaning}): {quantity} is no measurement: check the "
                        "transmitter, its wire and the channel's range",
                        device=unit.subject,
                        signal=register.name,
                        status=status,
                        meaning=register.meaning,
                        quantity=name,
                    )
                )

    def _measured(self) -> list[tuple[Unit, str]]:
        """Registers of the valve that have a status beside them, with their device."""
        wired = self._wired
        signals = [s for s in (wired.position, wired.pressure, wired.supply) if isinstance(s, Signal)]
        named = [(signal.unit, signal.register.name) for signal in signals]
        contacts = (wired.manual, wired.interlock)
        named += [(place.unit, place.contact.register) for place in contacts if place is not None]
        return [(unit, name) for unit, name in named if name in unit.map.statuses]

    def _check_live(self, unit: Unit, block: Block, words: tuple[int, ...]) -> None:
        live = unit.map.live
        if live is not None and block.registers[-1].name == live.check and words_crc16(words[:-1]) != words[-1]:
            self._faults.append(
                say(
                    "live_check_wrong",
                    "{device}: {check} does not fit the words before it: check the device's map",
                    device=unit.subject,
                    check=live.check,
                )
            )

    def _shown(self, name: str, signal: Signal | None) -> float | None:
        """Return what a signal shows; a value that is none is a fault."""
        value = None if signal is None else self._values[_key(signal.unit)].get(signal.register.name)
        if signal is None or value is None or math.isfinite(value):
            return value
        is_optional = signal is self._wired.pressure and self._wiring.pressure is None
        if not is_optional:  # a device of the reference map may have no pressure sensor
            self._faults.append(
                say(
                    "signal_not_valid",
                    "{device}: {signal} shows no valid {quantity}: check the sensor, its wire and its scaling",
                    device=signal.unit.subject,
                    signal=signal.register.name,
                    quantity=name,
                )
            )
        return None

    async def result(self, waveforms: Sequence[Waveform]) -> ValveSeen:
        """Read everything that answers."""
        wired, unit = self._wired, self._wired.command.unit
        await self._read()
        if isinstance(wired.position, Signal):
            self._position_m = self._shown("position", wired.position)
        fence, watchdog, status = unit.map.fence, unit.map.watchdog, self._status(unit)
        owner = None if fence is None else await self._tried(unit, partial(unit.value, fence.owner))
        state = None if watchdog is None else await self._tried(unit, partial(unit.value, watchdog.state))
        words = {} if watchdog is None else {watchdog.armed: "armed", watchdog.tripped: "tripped"}
        seen = ValveSeen(
            self._wiring.tag,
            tuple(self._devices),
            self._shown("output", wired.readback),
            self._position_m,
            self._shown("pressure", wired.pressure),
            self._supply_pa(unit),
            await self._condition(wired.manual, status, "manual"),
            await self._condition(wired.interlock, status, "interlock"),
            None if owner is None else round(owner),
            None if state is None else words.get(round(state), "off"),
        )
        permissives: tuple[Permissive, ...] = ()
        if not any(device.fault for device in self._devices):
            permissives = await self._permissives(waveforms)
        return replace(seen, permissives=permissives, faults=tuple(dict.fromkeys(self._faults)))

    def _status(self, unit: Unit) -> int | None:
        live = unit.map.live
        status = None if live is None else self._values[_key(unit)].get(live.status)
        if live is None or status is None:
            return None
        if round(status) & live.sensor_fault_mask:
            self._faults.append(
                say("sensor_bad", "{device} says that its sensor is bad: look at it", device=unit.subject)
            )
        return round(status)

    def _supply_pa(self, unit: Unit) -> float | None:
        live = unit.map.live
        if self._wired.supply is not None:
            return self._shown("supply pressure", self._wired.supply)
        value = None if live is None or live.supply is None else self._values[_key(unit)].get(live.supply)
        return value if value is not None and math.isfinite(value) else None

    async def _condition(self, contact: WiredContact | None, status: int | None, name: str) -> bool | None:
        if contact is not None:
            return await self._tried(contact.unit, contact.says)
        live = self._wired.command.unit.map.live
        mask = 0 if live is None else live.manual_mask if name == "manual" else live.interlock_mask
        return bool(status & mask) if status is not None and mask else None

    async def _permissives(self, waveforms: Sequence[Waveform]) -> tuple[Permissive, ...]:
        """Judge what must hold, as before a test; what a test would be refused for is a fault."""
        device = ValveDevice(self._wiring, self._wired)
        permit = _PERMIT if self._wiring.permissives.permit else None
        permissives = (await read_permissives(device, permit)).permissives
        self._faults += [missing_words([one]) for one in permissives if one.met is False]
        if self._wiring.acquisition.mode is Mode.CAPTURED and device.buffer is not None:
            period_s = device.buffer.kept_period_s(self._wiring.acquisition.period_s)
            for waveform in waveforms:
                try:
                    await device.buffer.check(Course(waveform, period_s))
                except (EquipmentError, WaveformError) as error:
                    self._faults.append(
                        say(
                            "sequence_refused",
                            "sequence {sequence}: {why}",
                            sequence=waveform.name,
                            why=message_of(error),
                        )
                    )
        return permissives
