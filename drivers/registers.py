"""Registers: what a device keeps where, and the only conversion between raw words and SI."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from valve.errors import ConfigurationError, DeviceError, ParameterError
from valve.messages import Message, say

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
class Span:
    """What a register can hold, in ``unit``: from ``least`` to ``greatest``, every ``step``; 0 for a float."""

    least: float
    greatest: float
    step: float
    unit: str

    @property
    def words(self) -> Message:
        """Return it in words."""
        if self.step > 0.0:
            return say(
                "span_in_steps",
                "{least:.12g} to {most:.12g} {unit} in steps of {step:.4g}",
                least=self.least,
                most=self.greatest,
                unit=self.unit,
                step=self.step,
            )
        return say("span", "{least:.12g} to {most:.12g} {unit}", least=self.least, most=self.greatest, unit=self.unit)


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
            raise ConfigurationError(
                say(
                    "register_address_outside",
                    "register {register}: address {address} is outside 0 to 65535",
                    register=self.name,
                    address=self.address,
                )
            )
        if self.scale == 0.0 or not (math.isfinite(self.scale) and math.isfinite(self.offset)):
            raise ConfigurationError(
                say(
                    "register_scale_bad",
                    "register {register}: scale {scale:g}, it must be finite and not 0",
                    register=self.name,
                    scale=self.scale,
                )
            )
        if self.writable and self.table is Table.INPUT:
            raise ConfigurationError(
                say(
                    "register_not_writable",
                    "register {register}: input registers cannot be written, use a holding register",
                    register=self.name,
                )
            )

    @property
    def words(self) -> int:
        """Number of 16-bit words."""
        return _STRUCT[self.kind].size // 2

    def decode(self, words: Sequence[int]) -> float:
        """Value in ``unit`` from its words; NaN where the raw value is no measurement."""
        if len(words) != self.words:
            raise DeviceError(
                say(
                    "register_words_missing",
                    "register {register}: {came} words came, {asked} were asked for: try again",
                    register=self.name,
                    came=len(words),
                    asked=self.words,
                )
            )
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
        if not math.isfinite(raw):
            raise ParameterError(
                say(
                    "register_value_not_finite",
                    "register {register}: {value} is not a finite number, give one in {unit}",
                    register=self.name,
                    value=value,
                    unit=self.unit,
                )
            )
        low, high = self._raw_ends
        number = raw if self.kind is Kind.F32 else round(raw)
        if not low <= number <= high:
            span = self.span
            ends = say(
                "span_in_unit",
                "{least:g} to {greatest:g} {unit}",
                least=span.least,
                greatest=span.greatest,
                unit=self.unit,
            )
            raise ParameterError(
                say(
                    "register_value_outside",
                    "register {register}: {value:g} {unit} is outside {ends}",
                    register=self.name,
                    value=value,
                    unit=self.unit,
                    ends=ends,
                )
            )
        return bytes_to_words(_ordered(_STRUCT[self.kind].pack(number), self.word_order))

    def nearest(self, value: float) -> float:
        """Value in ``unit`` that it holds after ``value`` was written. Raises ParameterError as ``encode``."""
        return self.decode(self.encode(value))

    def holds(self, value: float) -> bool:
        """Whether ``value`` in ``unit`` can be written, or shown, to the nearest step."""
        try:
            return math.isfinite(self.nearest(value))
        except ParameterError:
            return False

    @property
    def _raw_ends(self) -> tuple[float, float]:
        return _LIMITS[self.kind] if self.raw_range is None else self.raw_range

    @property
    def span(self) -> Span:
        """What it can hold."""
        least, greatest = sorted(self.scale * end + self.offset for end in self._raw_ends)
        return Span(least, greatest, self.resolution, self.unit)

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
        low, high = self._raw_ends
        return replace(self, raw_range=(max(low, ends[0]), min(high, ends[1])))

    def spanning(self, signal: tuple[float, float], quantity: tuple[float, float], unit: str) -> Register:
        """Return this register read as a quantity: ``signal`` (its own unit) stands for ``quantity`` (in ``unit``).

        A 4-20 mA input that carries 0 to 0.1 m: ``spanning((0.004, 0.020), (0.0, 0.1), "m")``.
        """
        if signal[0] == signal[1] or quantity[0] == quantity[1]:
            raise ConfigurationError(
                say(
                    "register_range_empty",
                    "register {register}: a range whose ends are equal carries no signal",
                    register=self.name,
                )
            )
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
            raise DeviceError(
                say(
                    "block_words_missing",
                    "block at {address}: {came} words came, {asked} were asked for",
                    address=self.address,
                    came=len(words),
                    asked=self.words,
                )
            )
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
            raise ConfigurationError(
                say(
                    "block_gap",
                    "block at {address}: a register between them is missing, write it too",
                    address=self.address,
                )
            )
        return [word for word in words if word is not None]
