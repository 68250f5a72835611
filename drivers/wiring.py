"""From names in a configuration to registers on a bus; every contradiction is found here, before anything is opened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

from drivers.addresses import MotionLimits, ValveWiring
from drivers.bus import Bus, Exchange, Gauge, Modbus, is_gauge
from drivers.capabilities import Role
from drivers.maps import register_map
from drivers.permissive_rules import Contact, PermissiveRules
from drivers.points import Point
from drivers.register_map import RegisterMap
from drivers.registers import MAX_READ_WORDS, Block, Register, Table
from valve.errors import ConfigurationError, refuse
from valve.messages import message_of, say

_Found = TypeVar("_Found")

_TOLERANCE_SHARE: Final = 1.0e-3  # of the pressure limits' span: an output card's own resolution


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """One device on a bus."""

    bus: Modbus
    device_id: int
    map: RegisterMap

    @property
    def subject(self) -> str:
        """Words for errors."""
        return say("device_on_bus", "device {device} on {bus}", device=self.device_id, bus=self.bus.name)

    async def values(self, *names: str) -> dict[str, float]:
        """Read registers in one transaction. Raises as ``Modbus.read`` does."""
        block = self.map.block(*names)
        return block.decode((await self.bus.read(self.device_id, block)).words)

    async def value(self, name: str) -> float:
        """Read one register."""
        return (await self.values(name))[name]

    async def write(self, values: Mapping[str, float], *, priority: bool = False) -> Exchange:
        """Write neighbouring registers in one transaction, once. Raises as ``Modbus.write`` does."""
        block, function = self.map.block(*values), self.map.write_function
        words = block.encode(dict(values))
        return await self.bus.write(self.device_id, block.address, words, priority=priority, function=function)


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """A register of a device, read or written as a quantity in Pa or m."""

    unit: Unit
    register: Register


@dataclass(frozen=True, slots=True, eq=False)
class WiredContact:
    """A register that says yes or no, on its device."""

    unit: Unit
    contact: Contact

    async def says(self) -> bool | None:
        """Read it fresh; None where it is no valid value. Raises WireError or DeviceError."""
        return self.contact.says(await self.unit.value(self.contact.register))


@dataclass(frozen=True, slots=True, eq=False)
class Wired:
    """The signals of one valve. ``position`` is a signal or a gauge; ``pressure`` may be absent.

    ``manual``, ``interlock`` and ``supply`` are there where the permissives name a place of their own for them.
    """

    command: Signal
    readback: Signal
    position: Signal | Gauge
    pressure: Signal | None
    manual: WiredContact | None = None
    interlock: WiredContact | None = None
    supply: Signal | None = None

    def tolerance_pa(self, limits: MotionLimits) -> float:
        """By how much a command and what the device shows of it may differ, Pa."""
        return max(
            _TOLERANCE_SHARE * (limits.pressure_pa[1] - limits.pressure_pa[0]),
            2.0 * self.command.register.resolution,
            2.0 * self.readback.register.resolution,
        )

    @property
    def units(self) -> tuple[Unit, ...]:
        """Every device that the valve is wired to, once, the one that is commanded first."""
        found: dict[tuple[str, int], Unit] = {}
        for signal in (self.command, self.position, self.pressure):
            if isinstance(signal, Signal):
                found.setdefault((signal.unit.bus.name, signal.unit.device_id), signal.unit)
        return tuple(found.values())


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """What names in a configuration stand for: buses, and the plant's own register maps."""

    buses: Mapping[str, Bus]
    maps: Mapping[str, RegisterMap]


def _unit(tag: str, point: Point, places: _Places) -> Unit | Gauge:
    buses = places.buses
    bus = buses.get(point.bus)
    if bus is None:
        raise ConfigurationError(
            say(
                "no_such_bus",
                "{tag}: no bus is called {bus}, choose one of {buses:, }",
                tag=tag,
                bus=repr(point.bus),
                buses=tuple(buses),
            )
        )
    if is_gauge(bus):
        return bus
    if point.device_id is None or point.map is None:
        raise ConfigurationError(
            say(
                "modbus_point_incomplete",
                "{tag}: bus {bus} is Modbus, give device_id and map of the device",
                tag=tag,
                bus=point.bus,
            )
        )
    fault = bus.address.device_id_fault(point.device_id)
    if fault:
        raise ConfigurationError(say("of_valves_bus", "{tag}: bus {bus}: {what}", tag=tag, bus=point.bus, what=fault))
    return Unit(bus, point.device_id, register_map(point.map, places.maps))


def _as_quantity(tag: str, role: str, register: Register, point: Point, si_unit: str) -> Register:
    if point.signal is not None and point.quantity is not None:
        return register.spanning(point.signal, point.quantity, si_unit)
    if register.unit != si_unit:
        raise ConfigurationError(
            say(
                "role_in_other_unit",
                "{tag}: the {role} stands in {register} in {unit}, not in {si_unit}: say by signal and "
                "quantity what it means",
                tag=tag,
                role=role,
                register=register.name,
                unit=register.unit,
                si_unit=si_unit,
            )
        )
    return register


def _measured(tag: str, role: Role, unit: Unit, point: Point, si_unit: str) -> Signal:
    name = point.register or unit.map.roles.get(role)
    if name is None:
        raise ConfigurationError(
            say(
                "map_without_role",
                "{tag}: map {map} has no {role} of its own, name the register",
                tag=tag,
                map=unit.map.name,
                role=role,
            )
        )
    register = unit.map.register(name).within_standard_signal()
    return Signal(unit, _as_quantity(tag, role, register, point, si_unit))


def _commanded(tag: str, unit: Unit, point: Point) -> tuple[Signal, Signal]:
    name = point.register or unit.map.roles.get(Role.COMMAND)
    if name is None:
        raise ConfigurationError(
            say(
                "map_without_command",
                "{tag}: map {map} has no command of its own, name the register",
                tag=tag,
                map=unit.map.name,
            )
        )
    if unit.map.is_positioner:
        raise ConfigurationError(
            say(
                "map_is_positioner",
                "{tag}: map {map} is a positioner, its {register} is a position, and friction is found from "
                "the pressure that moves the stem: command an I/P in pressure, the positioner may show the "
                "position",
                tag=tag,
                map=unit.map.name,
                register=name,
            )
        )
    register = unit.map.register(name)
    if not register.writable:
        raise ConfigurationError(
            say(
                "register_cannot_be_written",
                "{tag}: {register} of map {map} cannot be written, name another register",
                tag=tag,
                register=name,
                map=unit.map.name,
            )
        )
    shown = unit.map.register(point.readback_register or unit.map.readbacks.get(name, name))
    if shown.unit != register.unit:
        raise ConfigurationError(
            say(
                "readback_in_other_unit",
                "{tag}: {register} is in {unit} and its read-back {readback} in {readback_unit}, name another",
                tag=tag,
                register=name,
                unit=register.unit,
                readback=shown.name,
                readback_unit=shown.unit,
            )
        )
    command = Signal(unit, _as_quantity(tag, "command", register, point, "Pa"))
    return command, Signal(unit, _as_quantity(tag, "read-back", shown, point, "Pa"))


def wire(wiring: ValveWiring, buses: Mapping[str, Bus]) -> Wired:
    """Find what ``wiring`` names. Raises ConfigurationError, a line each, where it names nothing or contradicts itself.

    Nothing is opened or sent.
    """
    places = _Places(buses, wiring.maps)
    tag, rules, faults = wiring.tag, wiring.permissives, list[str]()

    def found(make: Callable[[], _Found]) -> _Found | None:
        try:
            return make()
        except ConfigurationError as error:
            faults.append(message_of(error))
            return None

    command = found(lambda: _command(tag, wiring.command, places))
    own = None if command is None else command[0].unit
    position = found(lambda: _position(wiring, own, places))
    pressure = found(lambda: _pressure(wiring, own, places))
    manual = found(lambda: _contact(tag, rules.manual, places))
    interlock = found(lambda: _contact(tag, rules.interlock, places))
    supply = found(lambda: _supply(tag, rules, places))
    refuse(ConfigurationError, faults)
    assert command is not None  # each None was refused above
    assert position is not None
    return Wired(*command, position, pressure, manual, interlock, supply)


def _modbus(tag: str, point: Point, places: _Places, lacks: str) -> Unit:
    unit = _unit(tag, point, places)
    if not isinstance(unit, Unit):
        raise ConfigurationError(
            say("bus_is_a_gauge", "{tag}: bus {bus} is a gauge, it {why}", tag=tag, bus=unit.name, why=lacks)
        )
    return unit


def _command(tag: str, point: Point, places: _Places) -> tuple[Signal, Signal]:
    return _commanded(tag, _modbus(tag, point, places, say("commands_nothing", "commands nothing")), point)


def _position(wiring: ValveWiring, own: Unit | None, places: _Places) -> Signal | Gauge | None:
    if wiring.position is None:
        point = Point(wiring.command.bus, wiring.command.device_id, wiring.command.map)
        return None if own is None else _measured(wiring.tag, Role.POSITION, own, point, "m")
    unit = _unit(wiring.tag, wiring.position, places)
    if not isinstance(unit, Unit):
        return unit
    return _measured(wiring.tag, Role.POSITION, unit, wiring.position, "m")


def _pressure(wiring: ValveWiring, own: Unit | None, places: _Places) -> Signal | None:
    if wiring.pressure is not None:
        unit = _modbus(wiring.tag, wiring.pressure, places, say("measures_no_pressure", "measures no pressure"))
        return _measured(wiring.tag, Role.PRESSURE, unit, wiring.pressure, "Pa")
    register = None if own is None else own.map.own_pressure
    return None if own is None or register is None else Signal(own, register)


def _supply(tag: str, rules: PermissiveRules, places: _Places) -> Signal | None:
    if rules.supply is None:
        return None
    unit = _modbus(tag, rules.supply, places, say("measures_no_pressure", "measures no pressure"))
    return _measured(tag, Role.SUPPLY, unit, rules.supply, "Pa")


def _contact(tag: str, contact: Contact | None, places: _Places) -> WiredContact | None:
    if contact is None:
        return None
    unit = _modbus(
        tag, Point(contact.bus, contact.device_id, contact.map), places, say("has_no_contact", "has no contact")
    )
    unit.map.register(contact.register)
    return WiredContact(unit, contact)


def read_blocks(unit: Unit, registers: Iterable[Register]) -> tuple[Block, ...]:
    """Fewest transactions that read ``registers``, over no address that the map does not have.

    A map with a live block is read by that block as a whole, where it holds them, so that its check can be made.
    """
    wanted = {(r.table, r.address): r for r in registers}
    blocks: list[Block] = []
    live = unit.map.live
    if live is not None:
        block = unit.map.block(*live.registers)
        inside = {key: r for key, r in wanted.items() if r.name in live.registers}
        if inside:
            named = {r.name: r for r in inside.values()}
            both = tuple(named.get(r.name, r) for r in block.registers)
            blocks.append(Block(both, block.address, block.words, block.table))
            wanted = {key: r for key, r in wanted.items() if key not in inside}
    for table in Table:
        rest = sorted((r for r in wanted.values() if r.table is table), key=lambda r: r.address)
        known = {a for r in unit.map.registers if r.table is table for a in range(r.address, r.address + r.words)}
        while rest:
            start, chosen = rest[0].address, [rest.pop(0)]
            while rest:
                end = rest[0].address + rest[0].words
                if end - start > MAX_READ_WORDS or not known.issuperset(range(start, end)):
                    break
                chosen.append(rest.pop(0))
            blocks.append(Block(tuple(chosen), start, chosen[-1].address + chosen[-1].words - start, table))
    return tuple(blocks)
