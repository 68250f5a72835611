"""Simulated valves and raw Modbus masters for these tests; the frames are written here, by nobody's driver."""

from __future__ import annotations

import asyncio
import contextlib
import os
import ssl
import struct
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from simulator.plant import SoftwareValve
from simulator.reference_unit import ReferenceUnit
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from valve.parameter_sets import parameter_set

RANGE_PA: Final = (0.0, 82737.0)
POSITION_SPAN_M: Final = (-0.005, 0.107)
PRESSURE_SPAN_PA: Final = (-4000.0, 87000.0)
DEADLINE_S: Final = 60.0

LIVE, LIVE_WORDS = 16, 13
RUN_NUMBER, CLAIM, RUN_OWNER, WATCHDOG, SAFE, WATCHDOG_STATE = 32, 36, 40, 44, 48, 50
CAPTURE, CAPTURE_STATE, TAKEN, INDEX = 52, 61, 62, 80
TAKE, RELEASE = 1, 2
PREPARE, START, ABORT = 1, 2, 3
CORNERS, WINDOW, WINDOW_WORDS = 1000, 8000, 123


def valve(tag: str = "FV-1", **changes: Any) -> SimulatedValve:
    """Return the nominal valve without noise; any setting may be changed."""
    chosen = parameter_set("nominal")
    settings: dict[str, Any] = {
        "parameters": chosen.parameters,
        "nameplate": chosen.nameplate,
        "transducer": Transducer(RANGE_PA),
        "position": Sensor(POSITION_SPAN_M),
        "pressure": Sensor(PRESSURE_SPAN_PA),
    }
    return SimulatedValve(tag, **{**settings, **changes})


def reference(settings: SimulatedValve | None = None) -> tuple[SoftwareValve, ReferenceUnit]:
    """Return a valve and the reference device that it hangs on."""
    software = SoftwareValve(valve() if settings is None else settings)
    return software, ReferenceUnit(1, software, position=software, pressure=software)


def u32(value: int) -> list[int]:
    return [value >> 16, value & 0xFFFF]


def f32(value: float) -> list[int]:
    return list(struct.unpack(">2H", struct.pack(">f", value)))


def floats(words: Sequence[int]) -> list[float]:
    """32-bit floats, high word first."""
    return list(struct.unpack(f">{len(words) // 2}f", struct.pack(f">{len(words)}H", *words)))


def number(words: Sequence[int]) -> int:
    return words[0] << 16 | words[1]


def corner_words(time_s: Sequence[float], pressure_pa: Sequence[float]) -> list[int]:
    words: list[int] = []
    for at_s, at_pa in zip(time_s, pressure_pa, strict=True):
        words += u32(round(at_s * 1.0e6)) + f32(at_pa)
    return words


def claim_words(run: int, claim: int = TAKE) -> list[int]:
    return [*u32(run), claim]


def watchdog_words(run: int, timeout_ms: int, heartbeat: int, safe_pa: float = 0.0) -> list[int]:
    return [*u32(run), timeout_ms, heartbeat, *f32(safe_pa)]


def capture_words(run: int, control: int, corners: Sequence[int], period_us: int, wanted: int) -> list[int]:
    """Words of the capture block; ``corners`` are the words of the table that it vouches for."""
    check = crc(b"".join(word.to_bytes(2, "big") for word in corners))
    return [*u32(run), control, len(corners) // 4, check, *u32(period_us), *u32(wanted)]


def from_codes(codes: Any, span: tuple[float, float]) -> Any:
    """Captured words 0 to 65534 as values over ``span``, 0xFFFF as NaN."""
    raw = np.asarray(codes, dtype=float)
    return np.where(raw == 0xFFFF, np.nan, span[0] + raw / 65534.0 * (span[1] - span[0]))


def crc(data: bytes) -> int:
    """CRC-16/MODBUS bit by bit, as the specification writes it."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value


def read_pdu(function: int, address: int, count: int) -> bytes:
    return struct.pack(">BHH", function, address, count)


def write_pdu(address: int, words: Sequence[int]) -> bytes:
    return struct.pack(f">BHHB{len(words)}H", 16, address, len(words), 2 * len(words), *words)


def read_write_pdu(read_at: int, count: int, write_at: int, words: Sequence[int]) -> bytes:
    return struct.pack(f">BHHHHB{len(words)}H", 23, read_at, count, write_at, len(words), 2 * len(words), *words)


class RefusedError(Exception):
    """The slave answered with a Modbus exception."""

    def __init__(self, function: int, code: int) -> None:
        super().__init__(f"function {function}, exception {code}")
        self.function, self.code = function, code


def payload(request: bytes, answer: bytes) -> list[int]:
    """Words of an answer to a read; those that it repeats of a write. Raises RefusedError for an exception."""
    if answer[0] == request[0] | 0x80:
        raise RefusedError(answer[0] & 0x7F, answer[1])
    assert answer[0] == request[0]
    data = answer[2:] if request[0] in (3, 4, 23) else answer[1:]
    if request[0] in (3, 4, 23):
        assert answer[1] == len(data)
    return list(struct.unpack(f">{len(data) // 2}H", data))


class TcpMaster:
    """One connection that sends one request at a time."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._transaction = 0

    @classmethod
    async def connect(cls, address: str, tls: ssl.SSLContext | None = None) -> TcpMaster:
        host, port = address.rsplit(":", 1)
        return cls(*await asyncio.open_connection(host, int(port), ssl=tls))

    def send(self, unit: int, pdu: bytes) -> int:
        self._transaction += 1
        self.writer.write(struct.pack(">HHHB", self._transaction, 0, len(pdu) + 1, unit) + pdu)
        return self._transaction

    async def receive(self, unit: int, transaction: int) -> bytes:
        async with asyncio.timeout(DEADLINE_S):
            head = await self.reader.readexactly(7)
            assert struct.unpack(">HHHB", head)[0::3] == (transaction, unit)
            return await self.reader.readexactly(struct.unpack(">H", head[4:6])[0] - 1)

    async def ask(self, pdu: bytes, unit: int = 1) -> list[int]:
        return payload(pdu, await self.receive(unit, self.send(unit, pdu)))

    async def close(self) -> None:
        self.writer.close()
        await self.writer.wait_closed()


class RtuMaster:
    """The master's end of a serial line, opened as a plain file."""

    def __init__(self, path: Path, *, raw: bool = True) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        if raw:
            tty.setraw(self._descriptor)

    def send(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    async def receive(self, length: int, deadline_s: float = DEADLINE_S) -> bytes:
        """Return ``length`` bytes, or what came until the deadline."""
        loop = asyncio.get_running_loop()
        end_s, data = loop.time() + deadline_s, b""
        while len(data) < length and loop.time() < end_s:
            with contextlib.suppress(BlockingIOError):
                data += os.read(self._descriptor, length - len(data))
            await asyncio.sleep(0.001)
        return data

    async def ask(self, pdu: bytes, answer_bytes: int, unit: int = 1) -> list[int]:
        frame = bytes([unit]) + pdu
        self.send(frame + crc(frame).to_bytes(2, "little"))
        answer = await self.receive(answer_bytes)
        assert len(answer) == answer_bytes
        assert answer[0] == unit
        assert crc(answer) == 0
        return payload(pdu, answer[1:-2])

    def close(self) -> None:
        os.close(self._descriptor)
