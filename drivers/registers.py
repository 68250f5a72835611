"""Registers: what a device keeps where, and the only conversion between raw words and SI."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

from drivers.capabilities import Capture, Fence, LiveBlock, Role, Watchdog
from valve.errors import ConfigurationError, DeviceError, ParameterError

MAX_READ_WORDS: Final = 125  # Modbus Application Protocol 1.1b3, 6.3
MAX_WRITE_WORDS: Final = 123  # the same, 6.12


class Table(StrEnum):
    """The two tables of 16-bit words."""

    HOLDING = "holding"
    INPUT = "input"


class Kind(StrEnum):
    """How a value is written in its words."""

    U16 = "u16"
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    F32 = "f32"


class WordOrder(StrEnum):
    """Order of the bytes of a 32-bit value, A the most significant."""

    ABCD = "ABCD"
    CDAB = "CDAB"
    BADC = "BADC"
    DCBA = "DCBA"


_STRUCT: Final = {
    Kind.U16: struct.Struct(">H"),
    Kind.I16: struct.Struct(">h"),
    Kind.U32: struct.Struct(">I"),
    Kind.I32: struct.Struct(">i"),
    Kind.F32: struct.Struct(">f"),
}
_LIMITS: Final[dict[Kind, tuple[float, float]]] = {
    Kind.U16: (0, 0xFFFF),
    Kind.I16: (-0x8000, 0x7FFF),
    Kind.U32: (0, 0xFFFFFFFF),
    Kind.I32: (-0x80000000, 0x7FFFFFFF),
    Kind.F32: (-3.4028e38, 3.4028e38),
}


_STANDARD_SIGNAL_A: Final = (3.6e-3, 21.0e-3)  # NAMUR NE 43


def _ordered(data: bytes, order: WordOrder) -> bytes:
    """Bytes A B C D in the order named; the same exchange undoes itself."""
    if len(data) != 4 or order is WordOrder.ABCD:
        return data
    a, b, c, d = data
    return {
        WordOrder.CDAB: bytes((c, d, a, b)),
        WordOrder.BADC: bytes((b, a, d, c)),
        WordOrder.DCBA: bytes((d, c, b, a)),
    }[order]


def words_to_bytes(words: Sequence[int]) -> bytes:
    """Bytes of words in wire order, the high byte first."""
    return struct.pack(f">{len(words)}H", *words)


def bytes_to_words(data: bytes) -> tuple[int, ...]:
    """Words of bytes in wire order; there must be an even number of them."""
    return struct.unpack(f">{len(data) // 2}H", data)


@dataclass(frozen=True, slots=True)
class Register:
    """One value in a device: where it stands, how it is written and what it means.

    The value is ``scale * raw + offset`` in ``unit`` (SI). ``address`` counts from 0, as on the wire. A raw value
    outside ``raw_range`` (where given) is not a measurement and decodes to NaN. Raises ConfigurationError where the
    description contradicts itself.
    """

    name: str
    address: int
    kind: Kind = Kind.U16
    table: Table = Table.HOLDING
    unit: str = "1"
    scale: float = 1.0
    offset: float = 0.0
    word_order: WordOrder = WordOrder.ABCD
    writable: bool = False
    raw_range: tuple[float, float] | None = None
    meaning: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.address <= 0x10000 - self.words:
            raise ConfigurationError(f"register {self.name}: address {self.address} is outside 0 to 65535")
        if self.scale == 0.0 or not (math.isfinite(self.scale) and math.isfinite(self.offset)):
            raise ConfigurationError(f"register {self.name}: scale {self.scale:g}, it must be finite and not 0")
        if self.writable and self.table is Table.INPUT:
            raise ConfigurationError(f"register {self.name}: input registers cannot be written, use a holding register")

    @property
    def words(self) -> int:
        """Number of 16-bit words."""
        return _STRUCT[self.kind].size // 2

    def decode(self, words: Sequence[int]) -> float:
        """Value in ``unit`` from its words; NaN where the raw value is no measurement."""
        if len(words) != self.words:
            raise DeviceError(f"register {self.name}: {len(words)} words came, {self.words} were asked for: try again")
        return self.decode_bytes(words_to_bytes(words))

    def decode_bytes(self, data: bytes) -> float:
        """Value in ``unit`` from its words' bytes in wire order (high byte first), as many as it has."""
        raw = float(_STRUCT[self.kind].unpack(_ordered(data, self.word_order))[0])
        if not math.isfinite(raw):
            return math.nan
        if self.raw_range is not None and not self.raw_range[0] <= raw <= self.raw_range[1]:
            return math.nan
        return self.scale * raw + self.offset

    def encode(self, value: float) -> tuple[int, ...]:
        """Words that stand for ``value`` in ``unit``, rounded to the nearest raw step.

        Raises ParameterError where the value cannot be written in this register.
        """
        raw = (value - self.offset) / self.scale
        low, high = _LIMITS[self.kind] if self.raw_range is None else self.raw_range
        if not math.isfinite(raw):
            raise ParameterError(f"register {self.name}: {value} is not a finite number, give one in {self.unit}")
        number = raw if self.kind is Kind.F32 else round(raw)
        if not low <= number <= high:
            ends = sorted((self.scale * low + self.offset, self.scale * high + self.offset))
            raise ParameterError(
                f"register {self.name}: {value:g} {self.unit} is outside {ends[0]:g} to {ends[1]:g} {self.unit}"
            )
        return bytes_to_words(_ordered(_STRUCT[self.kind].pack(number), self.word_order))

    @property
    def resolution(self) -> float:
        """Value of one raw step in ``unit``; 0 for a float."""
        return 0.0 if self.kind is Kind.F32 else abs(self.scale)

    def within_standard_signal(self) -> Register:
        """Return this register with every current that is no measurement as NaN; others than amperes as they are.

        Below 3.6 and above 21 mA a 4-20 mA transmitter reports a failure, or its wire is broken (NAMUR NE 43).
        """
        if self.unit != "A" or self.scale <= 0.0:
            return self
        ends = tuple((end - self.offset) / self.scale for end in _STANDARD_SIGNAL_A)
        low, high = _LIMITS[self.kind] if self.raw_range is None else self.raw_range
        return replace(self, raw_range=(max(low, ends[0]), min(high, ends[1])))

    def spanning(self, signal: tuple[float, float], quantity: tuple[float, float], unit: str) -> Register:
        """Return this register read as a quantity: ``signal`` (its own unit) stands for ``quantity`` (in ``unit``).

        A 4-20 mA input that carries 0 to 0.1 m: ``spanning((0.004, 0.020), (0.0, 0.1), "m")``.
        """
        if signal[0] == signal[1] or quantity[0] == quantity[1]:
            raise ConfigurationError(f"register {self.name}: a range whose ends are equal carries no signal")
        gain = (quantity[1] - quantity[0]) / (signal[1] - signal[0])
        return replace(
            self,
            unit=unit,
            scale=self.scale * gain,
            offset=(self.offset - signal[0]) * gain + quantity[0],
        )


@dataclass(frozen=True, slots=True)
class Block:
    """Registers read or written together in one transaction."""

    registers: tuple[Register, ...]
    address: int
    words: int
    table: Table

    def decode(self, words: Sequence[int]) -> dict[str, float]:
        """Values by register name."""
        if len(words) != self.words:
            raise DeviceError(f"block at {self.address}: {len(words)} words came, {self.words} were asked for")
        data = words_to_bytes(words)
        values = {}
        for register in self.registers:
            start = 2 * (register.address - self.address)
            values[register.name] = register.decode_bytes(data[start : start + 2 * register.words])
        return values

    def encode(self, values: dict[str, float]) -> list[int]:
        """Words of the whole block. Raises ConfigurationError where the values do not fill it."""
        words: list[int | None] = [None] * self.words
        for register in self.registers:
            start = register.address - self.address
            words[start : start + register.words] = list(register.encode(values[register.name]))
        if any(word is None for word in words):
            raise ConfigurationError(f"block at {self.address}: a register between them is missing, write it too")
        return [word for word in words if word is not None]


@dataclass(frozen=True, slots=True)
class GoldenFrame:
    """A request and its answer on a serial line, CRC included, as the manual prints them, with what they mean."""

    request: bytes
    answer: bytes
    values: dict[str, float]
    source: str


@dataclass(frozen=True, slots=True)
class Canary:
    """A register whose value proves which device answers, or (``differs``) which one does not."""

    register: str
    expected: float
    differs: bool = False

    def accepts(self, value: float) -> bool:
        """Whether this value is one that the device would show."""
        return (value != self.expected) if self.differs else (value == self.expected)


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """What one kind of device keeps where. ``source`` cites the manual page.

    ``roles`` names the register that serves a role where the wiring names none; ``readbacks`` tells for a command
    register where the device shows what it really asks for. Raises ConfigurationError where registers overlap, share
    a name, or a name stands for none.
    """

    name: str
    source: str
    registers: tuple[Register, ...]
    canary: Canary | None = None
    golden: tuple[GoldenFrame, ...] = ()
    version: Canary | None = None
    roles: Mapping[Role, str] = field(default_factory=dict)
    readbacks: Mapping[str, str] = field(default_factory=dict)
    fence: Fence | None = None
    watchdog: Watchdog | None = None
    live: LiveBlock | None = None
    capture: Capture | None = None
    has_read_write: bool = False  # function 23
    is_positioner: bool = False  # its command is a position of the stem
    number: str | None = None  # where it shows the number that its installer gave it

    def __post_init__(self) -> None:
        taken: dict[tuple[Table, int], str] = {}
        names: set[str] = set()
        for register in self.registers:
            if register.name in names:
                raise ConfigurationError(f"register map {self.name}: {register.name} stands in it twice, rename one")
            names.add(register.name)
            for address in range(register.address, register.address + register.words):
                other = taken.setdefault((register.table, address), register.name)
                if other != register.name:
                    raise ConfigurationError(
                        f"register map {self.name}: {other} and {register.name} overlap at {register.table} "
                        f"address {address}, move one"
                    )
        mentioned = [check.register for check in (self.canary, self.version) if check is not None]
        mentioned += [] if self.number is None else [self.number]
        for name in (*mentioned, *self.roles.values(), *self.readbacks, *self.readbacks.values()):
            self.register(name)

    def register(self, name: str) -> Register:
        """Return the register of this name. Raises ConfigurationError where there is none."""
        for register in self.registers:
            if register.name == name:
                return register
        known = ", ".join(register.name for register in self.registers)
        raise ConfigurationError(f"register map {self.name}: no register {name!r}; there are {known}")

    def block(self, *names: str) -> Block:
        """Return the one transaction that covers these registers.

        Raises ConfigurationError where they stand in different tables or too far apart.
        """
        chosen = tuple(self.register(name) for name in names)
        tables = {register.table for register in chosen}
        if len(tables) != 1:
            raise ConfigurationError(f"register map {self.name}: {', '.join(names)} stand in different tables")
        start = min(register.address for register in chosen)
        words = max(register.address + register.words for register in chosen) - start
        if words > MAX_READ_WORDS:
            raise ConfigurationError(
                f"register map {self.name}: {', '.join(names)} span {words} words, one read carries {MAX_READ_WORDS}"
            )
        return Block(chosen, start, words, tables.pop())


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ 0xA001 if byte & 1 else byte >> 1
    return byte


_CRC_OF_BYTE: Final = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(data: bytes) -> int:
    """CRC-16/MODBUS of ``data`` (Modbus over Serial Line 1.02, 6.2.2): polynomial 0xA001, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _CRC_OF_BYTE[(crc ^ byte) & 0xFF]
    return crc


def words_crc16(words: Sequence[int]) -> int:
    """CRC-16/MODBUS of words in wire order (high byte first)."""
    return crc16(words_to_bytes(words))
