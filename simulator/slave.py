"""Modbus slaves: the only module that speaks to pymodbus' server.

pymodbus brings framing and transport (TCP, TLS, serial). The five functions that move registers are answered by our
units at the moment of the request; every other function code, and whatever else its server would answer by itself, is
refused with exception 1. A request for a device id that nobody has is answered with exception 0x0B on TCP, as a
gateway does whose target is silent, and not at all on a serial line.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Final, cast

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.exceptions import ModbusIOException
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)
from pymodbus.server import ModbusSerialServer, ModbusTcpServer, ModbusTlsServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.registers import MAX_READ_WORDS, Table
from simulator.bus import Bus, NoSuchUnit
from simulator.listeners import Listener, TcpListener, tls_context
from simulator.serial_line import SerialLine
from simulator.unit import ExceptionCode, NoAnswer, Refusal
from valve.errors import ConfigurationError

_MOST_WORDS_OF_READ_WRITE: Final = 121  # Modbus Application Protocol 1.1b3, 6.17
_LONGEST_FRAME: Final = 260


class _Request(ModbusPDU):
    """A request that a bus answers; ``answer`` is what each function code does."""

    bus: Bus

    def response(self) -> ModbusPDU | None:
        """Carry the request out; its response or an exception, None where it stays unanswered by a fault.

        Raises NoSuchUnit where nobody has this device id.
        """
        try:
            response = self.answer(self.dev_id)
        except Refusal as refusal:
            response = ExceptionResponse(self.function_code, refusal.code)
        except NoAnswer:
            return None
        response.transaction_id, response.dev_id = self.transaction_id, self.dev_id
        return response

    def answer(self, device_id: int) -> ModbusPDU:
        """Carry the request out. Raises Refusal, NoAnswer or NoSuchUnit."""
        self.bus.require(device_id)
        raise Refusal(ExceptionCode.ILLEGAL_FUNCTION)

    def require_payload(self, words: int, byte_count: int | None, registers: Sequence[int]) -> None:
        """Raise Refusal unless a write carries as many words as it says."""
        if byte_count != 2 * words or len(registers) != words:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)


class _ReadHolding(_Request, ReadHoldingRegistersRequest):
    def decode(self, data: bytes) -> None:
        # pymodbus drops a request for 0 or for 126 words here; the protocol wants exception 3.
        self.address, self.count = int.from_bytes(data[:2], "big"), int.from_bytes(data[2:4], "big")

    def answer(self, device_id: int) -> ModbusPDU:
        return ReadHoldingRegistersResponse(registers=self.bus.read(device_id, Table.HOLDING, self.address, self.count))


class _ReadInput(_ReadHolding):
    function_code = 4

    def answer(self, device_id: int) -> ModbusPDU:
        return ReadInputRegistersResponse(registers=self.bus.read(device_id, Table.INPUT, self.address, self.count))


class _WriteOne(_Request, WriteSingleRegisterRequest):
    def answer(self, device_id: int) -> ModbusPDU:
        self.bus.write(device_id, self.address, self.registers)
        return WriteSingleRegisterResponse(address=self.address, registers=self.registers)


class _WriteMany(_Request, WriteMultipleRegistersRequest):
    def answer(self, device_id: int) -> ModbusPDU:
        self.require_payload(self.count, self.byte_count, self.registers)
        self.bus.write(device_id, self.address, self.registers)
        return WriteMultipleRegistersResponse(address=self.address, count=self.count)


class _ReadWrite(_Request, ReadWriteMultipleRegistersRequest):
    def decode(self, data: bytes) -> None:
        numbers = [int.from_bytes(data[at : at + 2], "big") for at in range(0, 8, 2)]
        self.read_address, self.read_count, self.write_address, self.write_count = numbers
        self.write_byte_count = data[8]
        self.write_registers = [int.from_bytes(data[at : at + 2], "big") for at in range(9, len(data) - 1, 2)]

    def answer(self, device_id: int) -> ModbusPDU:
        self.require_payload(self.write_count, self.write_byte_count, self.write_registers)
        if not 1 <= self.read_count <= MAX_READ_WORDS:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        self.bus.write(device_id, self.write_address, self.write_registers, _MOST_WORDS_OF_READ_WRITE)
        words = self.bus.read(device_id, Table.HOLDING, self.read_address, self.read_count)
        return ReadWriteMultipleRegistersResponse(registers=words)


_SERVED: Final = (_ReadHolding, _ReadInput, _WriteOne, _WriteMany, _ReadWrite)
# Lengths of other standard requests on a serial line, so that they can be refused there too.
_RTU_SIZES: Final = {1: 8, 2: 8, 5: 8, 7: 4, 8: 8, 11: 4, 12: 4, 17: 4, 22: 10, 24: 6}
_RTU_BYTE_COUNTS: Final = {15: 6, 20: 2, 21: 2}


def _requests(bus: Bus, *, serial: bool) -> list[type[ModbusPDU]]:
    """Request classes of one bus: the five that are served, and a refusal for every other function code."""
    served = {request.function_code: request for request in _SERVED}
    classes: list[type[ModbusPDU]] = []
    for code in range(1, 128):
        names = {"bus": bus, "function_code": code}
        if code in served:
            classes.append(type(served[code].__name__, (served[code],), names))
        elif not serial:
            classes.append(type("_Refused", (_Request,), names))
        elif code in _RTU_SIZES:
            classes.append(type("_Refused", (_Request,), {**names, "rtu_frame_size": _RTU_SIZES[code]}))
        elif code in _RTU_BYTE_COUNTS:
            classes.append(type("_Refused", (_Request,), {**names, "rtu_byte_count_pos": _RTU_BYTE_COUNTS[code]}))
    return classes


class _Connection(ServerRequestHandler):
    """One master's connection: every request is answered, in order, also where several come in one piece.

    pymodbus answers one of them and drops the rest; a device that was frozen executes them all.
    """

    def __init__(self, owner: ModbusTcpServer | ModbusSerialServer) -> None:
        super().__init__(owner, None, None, None)  # type: ignore[no-untyped-call]  # pymodbus gives it no types
        self._serial = isinstance(owner, ModbusSerialServer)
        self._received = b""
        self._last_s = 0.0

    def data_received(self, data: bytes) -> None:
        """Answer whatever is complete."""
        now_s = self.loop.time()
        # On a serial line a pause ends a frame, a broken one too (Modbus over Serial Line 1.02, 2.5.1.1).
        if self._serial and now_s - self._last_s > 0.05:
            self._received = b""
        self._last_s = now_s
        self._received += data
        while self._received:
            try:
                used, request = self.framer.handleFrame(self._received, 0, 0)
            except ModbusIOException:
                # A frame that is no request at all: a device closes the connection or waits for the line's pause.
                self._received = b""
                return
            self._received = self._received[used:]
            if isinstance(request, _Request):
                self._answer(request)
            elif used == 0:
                break
        if len(self._received) > _LONGEST_FRAME:
            self._received = b""

    def _answer(self, request: _Request) -> None:
        try:
            response = request.response()
        except NoSuchUnit:
            if self._serial:
                return
            response = ExceptionResponse(
                request.function_code,
                ExcCodes.GATEWAY_NO_RESPONSE,
                device_id=request.dev_id,
                transaction=request.transaction_id,
            )
        if response is not None and self.transport is not None:
            self.pdu_send(response)


def _placeholder() -> SimDevice:
    """Return the register memory that pymodbus insists on; our requests never touch it."""
    return SimDevice(0, simdata=[SimData(0, datatype=DataType.REGISTERS)])


class _TcpServer(ModbusTcpServer):
    def callback_new_connection(self) -> _Connection:
        return _Connection(self)


class _TlsServer(ModbusTlsServer):
    def callback_new_connection(self) -> _Connection:
        return _Connection(self)


class _SerialServer(ModbusSerialServer):
    def callback_new_connection(self) -> _Connection:
        return _Connection(self)


class Slave:
    """Units that are served on one listener, from ``start`` to ``stop``."""

    def __init__(self, listener: Listener, bus: Bus) -> None:
        self.listener = listener
        self.line: SerialLine | None = None
        self._bus = bus
        self._server: _TcpServer | _TlsServer | _SerialServer | None = None

    async def start(self) -> str:
        """Listen; return the address: ``host:port``, or the path of the serial line.

        Raises ConfigurationError where the address cannot be had.
        """
        if isinstance(self.listener, TcpListener):
            return await self._start_tcp(self.listener)
        self.line = SerialLine(self.listener.link_path)
        self._server = _SerialServer(
            _placeholder(),
            framer=FramerType.RTU,
            port=self.line.device_port,
            baudrate=115200,
            custom_pdu=_requests(self._bus, serial=True),
        )
        await self._server.serve_forever(background=True)
        return str(self.listener.link_path)

    async def _start_tcp(self, listener: TcpListener) -> str:
        address, requests = (listener.host, listener.port), _requests(self._bus, serial=False)
        if listener.certificate_file is None:
            self._server = _TcpServer(_placeholder(), address=address, custom_pdu=requests)
        else:
            self._server = _TlsServer(
                _placeholder(),
                address=address,
                custom_pdu=requests,
                sslctx=tls_context(listener),
                framer=FramerType.SOCKET,  # Modbus/TCP Security keeps the header; pymodbus' own framer cannot split
            )
        try:
            await self._server.serve_forever(background=True)
        except RuntimeError as error:
            raise ConfigurationError(
                f"{listener.host}:{listener.port}: the simulator cannot listen there, the port is taken or not "
                "allowed: choose another one"
            ) from error
        # asyncio's server object, or uvloop's, which is no subclass of it
        server = cast(asyncio.Server, self._server.transport)
        host, port = server.sockets[0].getsockname()[:2]
        return f"{host}:{port}"

    async def stop(self) -> None:
        """Stop listening and close every connection; a serial line disappears with its link."""
        if self._server is not None:
            self._server.close()
            self._server = None
        if self.line is not None:
            self.line.close()
            self.line = None
