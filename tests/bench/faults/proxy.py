"""A proxy between the service and the simulated devices that lets bytes through, but for one fault at one transaction.

``requests`` is everything that the service sent, before the fault: what it asked for, not what the wire made of it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Final

from simulator.serial_line import SerialLine
from tests.bench.faults.wire_faults import FaultAt, WireFault

DELAY_S: Final = 0.5  # longer than the deadline of a transaction
BLACK_HOLE_S: Final = 2.5  # longer than the watchdog
_MBAP: Final = 6
_OF_REQUESTS: Final = frozenset(fault for fault in WireFault if fault.name.endswith("_REQUEST"))


class FaultyWire:
    """Counts transactions and spoils one; ``on_fault`` is called as its request comes, before anything is carried."""

    def __init__(self, fault: FaultAt | None, on_fault: Callable[[], None] = lambda: None) -> None:
        self.fault = fault
        self._on_fault = on_fault
        self._random = random.Random(0 if fault is None else fault.seed)
        self._dark = False
        self.requests: list[bytes] = []
        self.reached = False
        self.cut: Callable[[], None] | None = None

    def _now(self) -> WireFault | None:
        fault = self.fault
        if fault is None or len(self.requests) - 1 != fault.index or not isinstance(fault.fault, WireFault):
            return None
        return fault.fault

    def request(self, frame: bytes, onward: Callable[[bytes], None], back: Callable[[bytes], None]) -> None:
        """Carry one request."""
        self.requests.append(frame)
        if self.fault is not None and len(self.requests) - 1 == self.fault.index:
            self.reached = True
            self._on_fault()
        match self._now():
            case WireFault.ECHO:
                back(frame)
            case WireFault.BLACK_HOLE:
                self._dark = True
                asyncio.get_running_loop().call_later(BLACK_HOLE_S, setattr, self, "_dark", False)
            case fault:
                self._carry(frame, onward, fault if fault in _OF_REQUESTS else None)

    def answer(self, frame: bytes, back: Callable[[bytes], None]) -> None:
        """Carry one answer."""
        match self._now():
            case WireFault.RESET:
                if self.cut is not None:
                    self.cut()
                else:
                    back(self._random.randbytes(len(frame)))
            case fault:
                self._carry(frame, back, None if fault in _OF_REQUESTS else fault)

    def _carry(self, frame: bytes, onward: Callable[[bytes], None], fault: WireFault | None) -> None:
        """Carry a frame, in whichever direction, as a fault of that direction spoils it."""
        match fault:
            case WireFault.DROP_REQUEST | WireFault.DROP_ANSWER:
                return
            case WireFault.DELAY_REQUEST | WireFault.DELAY_ANSWER:
                asyncio.get_running_loop().call_later(DELAY_S, onward, frame)
            case WireFault.DOUBLE_REQUEST | WireFault.DOUBLE_ANSWER:
                onward(frame)
                asyncio.get_running_loop().call_later(0.01, onward, frame)
            case WireFault.TRUNCATE_REQUEST | WireFault.TRUNCATE_ANSWER:
                onward(frame[: self._random.randrange(1, len(frame))])
            case WireFault.FLIP_REQUEST | WireFault.FLIP_ANSWER:
                onward(self._flipped(frame))
            case _:
                if not self._dark:
                    onward(frame)

    def _flipped(self, frame: bytes) -> bytes:
        # On TCP the protocol's own header is left alone where flipping it would only be another truncation.
        bit = self._random.randrange(8 * len(frame))
        spoilt = bytearray(frame)
        spoilt[bit // 8] ^= 1 << bit % 8
        return bytes(spoilt)


def _frames(received: bytes) -> tuple[list[bytes], bytes]:
    """Whole Modbus TCP frames, and what is left."""
    frames = []
    while len(received) >= _MBAP:
        end = _MBAP + int.from_bytes(received[4:6], "big")
        if len(received) < end:
            break
        frames.append(received[:end])
        received = received[end:]
    return frames, received


class TcpProxy:
    """Modbus TCP: listens on a free port and carries to another one."""

    def __init__(self, wire: FaultyWire, port: int) -> None:
        self._wire = wire
        self._upstream = port
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> int:
        """Return the port that it listens on."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Cut everything."""
        assert self._server is not None
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            device_reader, device_writer = await asyncio.open_connection("127.0.0.1", self._upstream)
            self._wire.cut = writer.transport.abort
            answers = asyncio.create_task(self._answers(device_reader, writer))
            try:
                await self._requests(reader, writer, device_writer)
            finally:
                answers.cancel()
                device_writer.close()
        except OSError:
            pass
        finally:
            self._tasks.discard(task)
            writer.close()

    async def _requests(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, device: asyncio.StreamWriter
    ) -> None:
        rest = b""
        while data := await reader.read(4096):
            frames, rest = _frames(rest + data)
            for frame in frames:
                self._wire.request(frame, device.write, writer.write)

    async def _answers(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        rest = b""
        while data := await reader.read(4096):
            frames, rest = _frames(rest + data)
            for frame in frames:
                self._wire.answer(frame, writer.write)
        writer.close()


class LineProxy:
    """Modbus RTU: a line of its own for the service, joined to the line of the devices."""

    def __init__(self, wire: FaultyWire, link: Path, device_link: Path) -> None:
        self._wire = wire
        self._line = SerialLine(link)
        self._near = os.open(self._line.device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._far = os.open(device_link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for descriptor in (self._near, self._far):
            tty.setraw(descriptor)
        loop = asyncio.get_running_loop()
        loop.add_reader(self._near, self._from_service)
        loop.add_reader(self._far, self._from_device)

    async def stop(self) -> None:
        """Take the line away."""
        loop = asyncio.get_running_loop()
        for descriptor in (self._near, self._far):
            loop.remove_reader(descriptor)
            os.close(descriptor)
        self._line.close()

    def _from_service(self) -> None:
        data = _read(self._near)
        if data:
            self._wire.request(data, self._to_device, self._to_service)

    def _from_device(self) -> None:
        data = _read(self._far)
        if data:
            self._wire.answer(data, self._to_service)

    def _to_device(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._far, data)

    def _to_service(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._near, data)


def _read(descriptor: int) -> bytes:
    with contextlib.suppress(OSError):
        return os.read(descriptor, 4096)
    return b""
