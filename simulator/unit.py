"""What answers under one device id: a register map whose registers show and move simulated valves.

Any map can be served this way: a bare I/O module, a positioner's feedback, one valve spread over several units. The
reference map's own logic (fence, watchdog, capture) is in ``simulator.reference_unit``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Final, Protocol

from drivers.register_map import RegisterMap
from drivers.registers import Kind, Register, Table
from simulator.faults import FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Event, Happening
from valve.errors import ConfigurationError
from valve.messages import say

_WHOLE_RANGE: Final[dict[Kind, tuple[float, float]]] = {
    Kind.U16: (0, 0xFFFF),
    Kind.I16: (-0x8000, 0x7FFF),
    Kind.U32: (0, 0xFFFFFFFF),
    Kind.I32: (-0x80000000, 0x7FFFFFFF),
}


class ExceptionCode(IntEnum):
    """Modbus exception codes that a unit answers (Modbus Application Protocol 1.1b3, 7)."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_ADDRESS = 2
    ILLEGAL_VALUE = 3


class Refusal(Exception):  # noqa: N818 (an answer of the protocol, not a fault of the program)
    """A request that is answered with a Modbus exception."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class NoAnswer(Exception):  # noqa: N818 (a silence, not a fault of the program)
    """A request that is not answered at all."""


class Unit(Protocol):
    """One device id: registers that are computed when they are read. Times are simulated, s."""

    device_id: int

    def read(self, table: Table, address: int, count: int, now_s: float) -> list[int]:
        """Words at these addresses. Raises Refusal or NoAnswer."""
        ...

    def write(self, address: int, words: Sequence[int], now_s: float) -> None:
        """Write words to holding registers. Raises Refusal or NoAnswer; then nothing has changed."""
        ...


class Quantity(StrEnum):
    """What a register shows or sets of a valve."""

    COMMAND = "command"  # the pressure asked for; reads as it was written
    OUTPUT = "output"  # the pressure that the device asks of the I/P now
    POSITION = "position"
    PRESSURE = "pressure"


@dataclass(frozen=True, slots=True)
class Channel:
    """A register of a unit and the valve behind it; ``register`` is scaled to Pa or m (``Register.spanning``)."""

    register: Register
    quantity: Quantity
    valve: SoftwareValve


def measured_words(register: Register, value: float) -> tuple[int, ...]:
    """Words as a converter gives them: a value beyond the register's range stays at its end.

    NaN becomes a NaN in a float register and a raw value outside ``raw_range`` in another, 0xFFFF where it has none.
    """
    if not math.isfinite(value):
        return _bad_words(register)
    if register.kind is Kind.F32:
        return register.encode(value)
    raw = (value - register.offset) / register.scale
    low, high = register.raw_range or _WHOLE_RANGE[register.kind]
    raw = min(max(raw, low), high)
    return register.encode(register.scale * raw + register.offset)


def _bad_words(register: Register) -> tuple[int, ...]:
    if register.kind is Kind.F32:
        return struct.unpack(">2H", struct.pack(">f", math.nan))
    low, high = _WHOLE_RANGE[register.kind]
    measured = register.raw_range or (low, high)
    raw = int(high if measured[1] < high else low if measured[0] > low else high)
    data = raw.to_bytes(2 * register.words, "big", signed=raw < 0)
    return struct.unpack(f">{register.words}H", data)


def registers_by_address(registers: Iterable[Register], table: Table) -> dict[int, Register]:
    """Return each address of a table that has a register, with its register."""
    return {
        address: register
        for register in registers
        if register.table is table
        for address in range(register.address, register.address + register.words)
    }


def covered(by_address: Mapping[int, Register], address: int, count: int) -> list[Register]:
    """Registers that lie wholly in a range of addresses, in order.

    Raises Refusal where an address has no register or a register would be cut: half of a value is not a value.
    """
    registers, at = [], address
    while at < address + count:
        register = by_address.get(at)
        if register is None or register.address != at or at + register.words > address + count:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        registers.append(register)
        at += register.words
    return registers


def obey_wire_faults(valves: Iterable[SoftwareValve]) -> None:
    """Raise Refusal or NoAnswer where a fault of one of these valves' devices says so; after a look at them."""
    for valve in valves:
        refusal = valve.fault(FaultKind.REFUSAL)
        if refusal is not None:
            raise Refusal(int(refusal.amount))
        if valve.fault(FaultKind.SILENCE) is not None:
            raise NoAnswer


class MapUnit:
    """A unit without logic of its own: registers that hold what was written, and channels to valves.

    Addresses without a register are refused with exception 2, as are writes to a register that is not writable; the
    map's canary reads as it should, 0 where it must only differ. A command outside the transducer's range acts as its
    nearest end.
    Raises ConfigurationError where a channel's register is not in the map or a command's is not writable.
    """

    def __init__(self, device_id: int, register_map: RegisterMap, channels: Sequence[Channel]) -> None:
        self.device_id = device_id
        self._channels = {channel.register.name: channel for channel in channels}
        self._valves = tuple({id(channel.valve): channel.valve for channel in channels}.values())
        for channel in channels:
            own = register_map.register(channel.register.name)
            if channel.quantity is Quantity.COMMAND and not own.writable:
                raise ConfigurationError(
                    say(
                        "unit_command_not_writable",
                        "unit {unit}: register {register} of map {map} cannot be written and was to carry a command: "
                        "choose a writable register",
                        unit=device_id,
                        register=own.name,
                        map=register_map.name,
                    )
                )
        self._registers = {table: registers_by_address(register_map.registers, table) for table in Table}
        self._words: dict[str, tuple[int, ...]] = {
            register.name: (0,) * register.words for register in register_map.registers
        }
        if register_map.canary is not None and not register_map.canary.differs:
            canary = register_map.register(register_map.canary.register)
            self._words[canary.name] = canary.encode(register_map.canary.expected)
        for channel in channels:
            if channel.quantity is Quantity.COMMAND:
                self._words[channel.register.name] = measured_words(channel.register, channel.valve.asked_pa)

    def read(self, table: Table, address: int, count: int, now_s: float) -> list[int]:
        """Words at these addresses, those of channels computed now."""
        for valve in self._valves:
            valve.look(now_s)
        obey_wire_faults(self._valves)
        words: list[int] = []
        fresh: dict[str, tuple[int, ...]] = {}
        for at in range(address, address + count):
            register = self._registers[table].get(at)
            if register is None:
                raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
            if register.name not in fresh:
                fresh[register.name] = self._value_words(register.name)
            words.append(fresh[register.name][at - register.address])
        return words

    def _value_words(self, name: str) -> tuple[int, ...]:
        channel = self._channels.get(name)
        if channel is None or channel.quantity is Quantity.COMMAND:
            return self._words[name]
        valve = channel.valve
        if channel.quantity is Quantity.POSITION:
            value = valve.read_position_m()
        elif channel.quantity is Quantity.PRESSURE:
            value = valve.read_pressure_pa()
        else:
            value = valve.asked_pa
        return measured_words(channel.register, value)

    def write(self, address: int, words: Sequence[int], now_s: float) -> None:
        """Write whole registers; a command takes effect now."""
        for valve in self._valves:
            valve.look(now_s)
        silent = any(valve.fault(FaultKind.SILENCE) is not None for valve in self._valves)
        if not silent:
            obey_wire_faults(self._valves)
        registers = covered(self._registers[Table.HOLDING], address, len(words))
        if not all(register.writable for register in registers):
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        pieces = {register.name: tuple(words[register.address - address :][: register.words]) for register in registers}
        commands = {name: self._channels[name] for name in pieces if name in self._channels}
        for name, channel in commands.items():
            if not math.isfinite(channel.register.decode(pieces[name])):
                raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        for name, piece in pieces.items():
            self._carry_out(name, piece)
        if silent:
            raise NoAnswer

    def _carry_out(self, name: str, words: tuple[int, ...]) -> None:
        channel = self._channels.get(name)
        if channel is None:
            self._words[name] = words
            return
        valve, pressure_pa = channel.valve, channel.register.decode(words)
        ignored = valve.fault(FaultKind.IGNORED_WRITES) is not None
        happening = Happening.IGNORED if ignored else Happening.COMMANDED
        valve.record.add(
            Event(
                valve.time_s,
                valve.settings.tag,
                happening,
                self.device_id,
                channel.register.address,
                words,
                pressure_pa,
            )
        )
        if not ignored:
            self._words[name] = words
            valve.ask(pressure_pa)
