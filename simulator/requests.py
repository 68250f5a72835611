"""What a Modbus request asks of the units on a wire, and its answer: function and data, without what a carrier adds.

Functions 3, 4, 6, 16 and 23 move registers and are answered by the units at the moment of the request; every other
one is refused with exception 1 (Modbus Application Protocol 1.1b3, 6). Nothing here is shared with the drivers' side
of the wire, so that each judges the other.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Final

from drivers.registers import MAX_READ_WORDS, Table
from simulator.bus import Bus
from simulator.unit import ExceptionCode, NoAnswer, Refusal

_READ_WRITE_WORDS: Final = 121  # that function 23 writes at most (the same, 6.17)
_LENGTHS: Final = {1: 8, 2: 8, 3: 8, 4: 8, 5: 8, 6: 8, 7: 4, 8: 8, 11: 4, 12: 4, 17: 4, 22: 10, 24: 6}
_BYTE_COUNTS: Final = {15: 6, 16: 6, 20: 2, 21: 2, 23: 10}  # where a frame says how many bytes follow


def answer(bus: Bus, device_id: int, request: bytes) -> bytes | None:
    """Carry a request out; return its answer or an exception, None where a fault leaves it unanswered.

    Raises NoSuchUnit where nobody has this device id.
    """
    function, data = request[0], request[1:]
    bus.require(device_id)
    try:
        if function not in _SERVED:
            raise Refusal(ExceptionCode.ILLEGAL_FUNCTION)
        return bytes((function,)) + _SERVED[function](bus, device_id, data)
    except Refusal as refusal:
        return bytes((function | 0x80, refusal.code))
    except NoAnswer:
        return None


def serial_length(frame: bytes) -> int | None:
    """Return how long the serial frame is that begins so, CRC included; 0 while too little has come to tell.

    None where it begins with no function that a request can have on a serial line.
    """
    function = frame[1]
    if function in _LENGTHS:
        return _LENGTHS[function]
    at = _BYTE_COUNTS.get(function)
    if at is None:
        return None
    return at + 1 + frame[at] + 2 if len(frame) > at else 0


def _numbers(data: bytes, count: int) -> tuple[int, ...]:
    """Return the first numbers of a request. Raises Refusal where it is cut short."""
    if len(data) < 2 * count:
        raise Refusal(ExceptionCode.ILLEGAL_VALUE)
    return struct.unpack(f">{count}H", data[: 2 * count])


def _payload(words: int, data: bytes) -> tuple[int, ...]:
    """Return the words of a write, which stand behind their count of bytes. Raises Refusal unless all are there."""
    if len(data) != 1 + 2 * words or data[0] != 2 * words:
        raise Refusal(ExceptionCode.ILLEGAL_VALUE)
    return _numbers(data[1:], words)


def _words_read(words: Sequence[int]) -> bytes:
    return struct.pack(f">B{len(words)}H", 2 * len(words), *words)


def _read_holding(bus: Bus, device_id: int, data: bytes) -> bytes:
    return _words_read(bus.read(device_id, Table.HOLDING, *_numbers(data, 2)))


def _read_input(bus: Bus, device_id: int, data: bytes) -> bytes:
    return _words_read(bus.read(device_id, Table.INPUT, *_numbers(data, 2)))


def _write_one(bus: Bus, device_id: int, data: bytes) -> bytes:
    address, word = _numbers(data, 2)
    bus.write(device_id, address, [word])
    return data[:4]


def _write_many(bus: Bus, device_id: int, data: bytes) -> bytes:
    address, count = _numbers(data, 2)
    bus.write(device_id, address, list(_payload(count, data[4:])))
    return data[:4]


def _read_write(bus: Bus, device_id: int, data: bytes) -> bytes:
    read_address, read_count, write_address, write_count = _numbers(data, 4)
    words = list(_payload(write_count, data[8:]))
    if not 1 <= read_count <= MAX_READ_WORDS:
        raise Refusal(ExceptionCode.ILLEGAL_VALUE)
    bus.write(device_id, write_address, words, _READ_WRITE_WORDS)
    return _words_read(bus.read(device_id, Table.HOLDING, read_address, read_count))


_SERVED: Final[dict[int, Callable[[Bus, int, bytes], bytes]]] = {
    3: _read_holding,
    4: _read_input,
    6: _write_one,
    16: _write_many,
    23: _read_write,
}
