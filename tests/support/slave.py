"""A Modbus slave of a few raw frames, independent of any library, that can misbehave on demand."""

from __future__ import annotations

import asyncio
import os
import pty
import ssl
import time
import tty
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field

from drivers.crc import crc16


@dataclass(frozen=True)
class Fault:
    """What is done to one answer; the default does nothing."""

    delay_s: float = 0.0
    drop: bool = False
    copies: int = 1
    cut: int = 0  # bytes that are missing at the end
    echo: bool = False  # the request comes back before the answer
    unit: int | None = None
    function: int | None = None
    transaction: int | None = None
    words: tuple[int, ...] | None = None  # other words than were asked for
    exception: int | None = None
    flip: int | None = None  # bit of the answer (function and data) that is turned over, after the CRC was made
    hang_up: bool = False
    stray: bytes = b""  # noise before the answer, after the echo if there is one
    silent_execution: bool = True  # whether a dropped request is carried out


OK = Fault()


def word_bytes(words: list[int] | tuple[int, ...]) -> bytes:
    return b"".join(word.to_bytes(2, "big") for word in words)


@dataclass
class RawSlave:
    """Holding and input registers by unit; ``faults`` are used up one a request."""

    holding: dict[tuple[int, int], int] = field(default_factory=dict)
    inputs: dict[tuple[int, int], int] = field(default_factory=dict)
    faults: deque[Fault] = field(default_factory=deque)
    always: Fault = OK
    requests: list[bytes] = field(default_factory=list)  # unit, function and data of each
    asked_s: list[float] = field(default_factory=list)  # when each of them came
    asked: asyncio.Event = field(default_factory=asyncio.Event)
    in_flight: int = 0
    most_in_flight: int = 0
    on_write: Callable[[int, int, list[int]], int | None] | None = None  # returns an exception code to refuse
    on_read: Callable[[int, int, int], None] | None = None
    hangs_up: bool = False  # it closes a connection once its answer is out
    functions: frozenset[int] = frozenset({3, 4, 6, 16, 23})  # that it knows

    @property
    def writes(self) -> list[tuple[int, int, list[int]]]:
        """Unit, address and words of every function 16 and 6 that came."""
        return [
            (
                r[0],
                int.from_bytes(r[2:4], "big"),
                [int.from_bytes(r[i : i + 2], "big") for i in range(7 if r[1] == 16 else 4, len(r), 2)],
            )
            for r in self.requests
            if r[1] in (6, 16)
        ]

    def set_words(self, unit: int, address: int, words: list[int] | tuple[int, ...]) -> None:
        for offset, word in enumerate(words):
            self.holding[unit, address + offset] = word

    def _read(self, unit: int, function: int, address: int, count: int) -> bytes:
        if self.on_read is not None:
            self.on_read(unit, address, count)
        table = self.inputs if function == 4 else self.holding
        if any((unit, address + i) not in table for i in range(count)):
            return bytes((function | 0x80, 2))
        return bytes((function, 2 * count)) + word_bytes([table[unit, address + i] for i in range(count)])

    def _write(self, unit: int, address: int, words: list[int]) -> int | None:
        if self.on_write is not None and (code := self.on_write(unit, address, words)) is not None:
            return code
        self.set_words(unit, address, words)
        return None

    def answer(self, unit: int, pdu: bytes) -> bytes:
        function, address, count = pdu[0], int.from_bytes(pdu[1:3], "big"), int.from_bytes(pdu[3:5], "big")
        if function not in self.functions:
            return bytes((function | 0x80, 1))
        if function == 6:
            code = self._write(unit, address, [count])
            return pdu if code is None else bytes((function | 0x80, code))
        if function in (3, 4):
            return self._read(unit, function, address, count)
        if function == 16:
            words = [int.from_bytes(pdu[i : i + 2], "big") for i in range(6, len(pdu), 2)]
            code = self._write(unit, address, words)
            return pdu[:5] if code is None else bytes((function | 0x80, code))
        if function == 23:
            words = [int.from_bytes(pdu[i : i + 2], "big") for i in range(10, len(pdu), 2)]
            code = self._write(unit, int.from_bytes(pdu[5:7], "big"), words)
            return self._read(unit, function, address, count) if code is None else bytes((function | 0x80, code))
        return bytes((function | 0x80, 1))

    def _spoiled(self, unit: int, pdu: bytes, fault: Fault) -> bytes:
        if fault.exception is not None:
            return bytes((pdu[0] | 0x80, fault.exception))
        if fault.drop and not fault.silent_execution:
            return b""
        answer = self.answer(unit, pdu)
        if fault.words is not None:
            answer = bytes((answer[0], 2 * len(fault.words))) + word_bytes(fault.words)
        if fault.function is not None:
            answer = bytes((fault.function,)) + answer[1:]
        return answer

    async def serve(self, unit: int, pdu: bytes, frame: Callable[[int, bytes, Fault], bytes], raw: bytes) -> bytes:
        """Bytes to send back for one request, after its delay."""
        scripted = bool(self.faults)
        fault = self.faults.popleft() if scripted else self.always
        self.requests.append(bytes((unit,)) + pdu)
        self.asked_s.append(time.monotonic())
        self.asked.set()
        answer = self._spoiled(unit, pdu, fault)
        if not scripted:
            fault = self.always  # a write may have changed it
        self.in_flight += 1
        self.most_in_flight = max(self.most_in_flight, self.in_flight)
        if fault.delay_s > 0.0:
            await asyncio.sleep(fault.delay_s)
        self.in_flight -= 1
        if fault.hang_up:
            raise ConnectionResetError
        if fault.drop:
            return raw if fault.echo else b""
        whole = frame(unit if fault.unit is None else fault.unit, answer, fault)
        if fault.flip is not None:
            spoiled = bytearray(whole)
            spoiled[-3 - fault.flip // 8] ^= 1 << (fault.flip % 8)
            whole = bytes(spoiled)
        whole = fault.stray + whole[: len(whole) - fault.cut] * fault.copies
        return raw + whole if fault.echo else whole


class TcpPort:
    """Serve a slave on a free port of the loopback; each request is answered in its own task, so late ones overlap."""

    def __init__(self, slave: RawSlave, tls: ssl.SSLContext | None = None) -> None:
        self.slave, self.tls = slave, tls
        self.connections = 0
        self.port = 0
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> TcpPort:
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", 0, ssl=self.tls)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _spawn(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        here = asyncio.current_task()
        assert here is not None
        self._tasks.add(here)
        try:
            while True:
                head = await reader.readexactly(7)
                pdu = await reader.readexactly(int.from_bytes(head[4:6], "big") - 1)
                self._spawn(self._answer(writer, head, pdu))
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError, ssl.SSLError):
            pass
        finally:
            self._tasks.discard(here)
            writer.close()

    async def _answer(self, writer: asyncio.StreamWriter, head: bytes, pdu: bytes) -> None:
        def frame(unit: int, answer: bytes, fault: Fault) -> bytes:
            transaction = head[:2] if fault.transaction is None else fault.transaction.to_bytes(2, "big")
            return transaction + b"\0\0" + (len(answer) + 1).to_bytes(2, "big") + bytes((unit,)) + answer

        try:
            writer.write(await self.slave.serve(head[6], pdu, frame, head + pdu))
            if self.slave.hangs_up:
                writer.close()
        except ConnectionResetError:
            writer.transport.abort()


class SerialPort:
    """Serve a slave on a pseudo-terminal; ``path`` is the master's end."""

    def __init__(self, slave: RawSlave, units: tuple[int, ...] = (1,), *, paced: int | None = None) -> None:
        self.slave, self.units = slave, units
        self.paced = paced  # baud rate whose time the frames take; a pseudo-terminal alone takes none
        self.piece = 0  # bytes that come at a time; 0: all
        self._buffer = b""
        self._tasks: set[asyncio.Task[None]] = set()
        self._ours = self._theirs = -1
        self.path = ""

    async def __aenter__(self) -> SerialPort:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)
        asyncio.get_running_loop().add_reader(self._ours, self._heard)
        return self

    async def __aexit__(self, *_: object) -> None:
        self.unplug()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def unplug(self) -> None:
        """Pull the cable: the master's end reports a hang-up."""
        if self._ours >= 0:
            asyncio.get_running_loop().remove_reader(self._ours)
            os.close(self._ours)
            os.close(self._theirs)
            self._ours = -1

    def say(self, data: bytes) -> None:
        """Put bytes on the line that nobody asked for."""
        os.write(self._ours, data)

    def _heard(self) -> None:
        self._buffer += os.read(self._ours, 1024)
        while len(self._buffer) >= 8:
            function = self._buffer[1]
            length = {3: 8, 4: 8, 6: 8, 16: 9 + self._buffer[6]}.get(function, 0)
            if function == 23:
                length = 13 + self._buffer[10] if len(self._buffer) > 10 else 999
            if length == 0:
                self._buffer = b""
                return
            if len(self._buffer) < length:
                return
            raw, self._buffer = self._buffer[:length], self._buffer[length:]
            if crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little") and raw[0] in self.units:
                task = asyncio.ensure_future(self._answer(raw))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)

    async def _answer(self, raw: bytes) -> None:
        def frame(unit: int, answer: bytes, _: Fault) -> bytes:
            body = bytes((unit,)) + answer
            return body + crc16(body).to_bytes(2, "little")

        data = await self.slave.serve(raw[0], raw[1:-2], frame, raw)
        if self.paced is not None:
            await asyncio.sleep((len(raw) + len(data)) * 11 / self.paced)
        step = self.piece or len(data)
        for start in range(0, len(data), max(1, step)):
            if start:
                await asyncio.sleep(0.016)  # latency timer of a USB adapter
            if self._ours >= 0:
                os.write(self._ours, data[start : start + step])
