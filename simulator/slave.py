"""Modbus slaves: the units of a bus behind a TCP port, with or without TLS, or behind a serial line.

A request for a device id that nobody has is answered with exception 0x0B on TCP, as a gateway does whose target is
silent, and not at all on a serial line.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
import tty
from typing import Final, cast

from typing_extensions import override

from drivers.crc import crc16
from simulator.bus import Bus, NoSuchUnit
from simulator.listeners import Listener, TcpListener, tls_context
from simulator.requests import answer, serial_length
from simulator.serial_line import SerialLine
from valve.errors import ConfigurationError
from valve.messages import say

_TARGET_SILENT: Final = 0x0B  # gateway target device failed to respond (Modbus Application Protocol 1.1b3, 7)
_LONGEST_FRAME: Final = 260  # the same on every carrier (Messaging on TCP/IP 1.0b, 3.1.3)
_SHORTEST: Final = 4  # of a serial frame: device id, function, CRC
_HEADER: Final = struct.Struct(">HHHB")
_PAUSE_S: Final = 0.05  # that ends a frame, a broken one too (Modbus over Serial Line 1.02, 2.5.1.1)


class _Network(asyncio.Protocol):
    """One master's connection: every request is answered, in order, also where several come in one piece."""

    def __init__(self, bus: Bus, open_now: set[asyncio.Transport]) -> None:
        self._bus = bus
        self._open_now = open_now
        self._received = b""
        self._transport: asyncio.Transport

    @override
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._open_now.add(self._transport)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._open_now.discard(self._transport)

    @override
    def data_received(self, data: bytes) -> None:
        self._received += data
        while len(self._received) > _HEADER.size:
            transaction, protocol, length, device_id = _HEADER.unpack_from(self._received)
            if protocol != 0 or not 2 <= length <= _LONGEST_FRAME:
                self._received = b""  # no Modbus/TCP, and no knowing where the next request begins
                return
            end = 6 + length
            if len(self._received) < end:
                return
            request, self._received = self._received[_HEADER.size : end], self._received[end:]
            if 0 < request[0] < 0x80:
                self._answer(transaction, device_id, request)

    def _answer(self, transaction: int, device_id: int, request: bytes) -> None:
        try:
            said = answer(self._bus, device_id, request)
        except NoSuchUnit:
            said = bytes((request[0] | 0x80, _TARGET_SILENT))
        if said is not None:
            self._transport.write(_HEADER.pack(transaction, 0, 1 + len(said), device_id) + said)


class _Line:
    """The device's end of a serial line, which carries one request at a time."""

    def __init__(self, bus: Bus, port: str) -> None:
        self._bus = bus
        self._loop = asyncio.get_running_loop()
        self._received = b""
        self._last_s = 0.0
        self._port = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._port)
        self._loop.add_reader(self._port, self._read)

    def close(self) -> None:
        self._loop.remove_reader(self._port)
        os.close(self._port)

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._port, _LONGEST_FRAME)
            now_s = self._loop.time()
            if now_s - self._last_s > _PAUSE_S:
                self._received = b""
            self._last_s = now_s
            self._received += data
        frame = self._frame()
        if frame:
            self._answer(frame[0], frame[1:-2])

    def _frame(self) -> bytes:
        """Return the request that has come, b"" while there is none; noise before it is passed over."""
        received = self._received
        for start in range(len(received) - _SHORTEST + 1):
            length = serial_length(received[start:])
            if length is None:
                continue
            if length == 0 or len(received) < start + length:
                break
            self._received = b""
            frame = received[start : start + length]
            return frame if crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little") else b""
        if len(received) > _LONGEST_FRAME:
            self._received = b""
        return b""

    def _answer(self, device_id: int, request: bytes) -> None:
        with contextlib.suppress(NoSuchUnit):
            said = answer(self._bus, device_id, request)
            if said is not None:
                frame = bytes((device_id,)) + said
                with contextlib.suppress(BlockingIOError):  # bytes that nobody takes are lost, as on a wire
                    os.write(self._port, frame + crc16(frame).to_bytes(2, "little"))


class Slave:
    """Units that are served on one listener, from ``start`` to ``stop``."""

    def __init__(self, listener: Listener, bus: Bus) -> None:
        self.listener = listener
        self.line: SerialLine | None = None
        self._bus = bus
        self._server: asyncio.Server | None = None
        self._open_now: set[asyncio.Transport] = set()
        self._device: _Line | None = None

    async def start(self) -> str:
        """Listen; return the address: ``host:port``, or the path of the serial line.

        Raises ConfigurationError where the address cannot be had.
        """
        if isinstance(self.listener, TcpListener):
            return await self._start_tcp(self.listener)
        self.line = SerialLine(self.listener.link_path)
        self._device = _Line(self._bus, self.line.device_port)
        return str(self.listener.link_path)

    async def _start_tcp(self, listener: TcpListener) -> str:
        context = None if listener.certificate_file is None else tls_context(listener)
        try:
            self._server = await asyncio.get_running_loop().create_server(
                lambda: _Network(self._bus, self._open_now), listener.host, listener.port, ssl=context
            )
        except OSError as error:
            raise ConfigurationError(
                say(
                    "simulator_cannot_listen",
                    "{host}:{port}: the simulator cannot listen there, the port is taken or not allowed: choose "
                    "another one",
                    host=listener.host,
                    port=listener.port,
                )
            ) from error
        host, port = self._server.sockets[0].getsockname()[:2]
        return f"{host}:{port}"

    async def stop(self) -> None:
        """Stop listening and close every connection; a serial line disappears with its link."""
        if self._server is not None:
            self._server.close()
            self._server = None
            for transport in tuple(self._open_now):
                transport.close()
        if self._device is not None:
            self._device.close()
            self._device = None
        if self.line is not None:
            self.line.close()
            self.line = None
