"""One bus: requests go out one at a time, each with its own deadline, and only a checked answer comes back.

The one module that speaks to pymodbus' client. pymodbus carries the bytes; deadlines, order, checks and recovery
are here, because its own would repeat writes, take a late answer for the next one and wait behind its queue.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient, AsyncModbusTlsClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
)

from drivers.addresses import RtuAddress, TcpAddress, TlsAddress
from drivers.faults import (
    BadAnswerError,
    ConnectionLostError,
    EchoError,
    GatewayPathError,
    GatewayTargetError,
    NoAnswerError,
)
from drivers.frames import (
    READ_HOLDING,
    READ_INPUT,
    READ_WRITE,
    WRITE,
    Request,
    checked_words,
    mbap_answer,
    read_request,
    rtu_answer,
)
from drivers.gate import Gate
from drivers.registers import Block, Table
from valve.errors import ConfigurationError, DeviceError, WireError

_CHARACTER_BITS: Final = 11  # start, eight data, parity or second stop, stop (Modbus over Serial Line 1.02, 2.5.1)
_LONGEST_SILENCE_S: Final = 1.75e-3  # the gap above 19200 baud (the same, 2.5.1.1)
_CANARY_ATTEMPTS: Final = 3
_TLS_HANDSHAKE_S: Final = 2.0  # on top of the transaction's deadline: two certificates are checked
_RTU_FRAME_OVERHEAD: Final = 3

# What pymodbus would print is said by the errors here; who configures logging still gets it.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

_Client = AsyncModbusTcpClient | AsyncModbusSerialClient


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request that was answered: the words that came, and when it went out and the answer was there (monotonic)."""

    words: tuple[int, ...]
    sent_s: float
    received_s: float


@dataclass(frozen=True, slots=True)
class _Doubt:
    """Why the next answer on this bus cannot be believed yet: this request's own may still come."""

    request: Request
    sent_s: float


@dataclass(frozen=True, slots=True)
class _Canary:
    """Words that a device always shows."""

    table: Table
    address: int
    words: tuple[int, ...]


def _tls_context(address: TlsAddress) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=address.ca_file)
        if address.certificate_file is not None:
            context.load_cert_chain(address.certificate_file, address.key_file)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(
            f"bus {address.name}: its certificates cannot be used ({error}): check the files"
        ) from error
    return context


def _pdu(request: Request) -> ModbusPDU:
    words = list(request.words)
    if request.function == READ_HOLDING:
        return ReadHoldingRegistersRequest(
            dev_id=request.device_id, address=request.read_address, count=request.read_count
        )
    if request.function == READ_INPUT:
        return ReadInputRegistersRequest(
            dev_id=request.device_id, address=request.read_address, count=request.read_count
        )
    if request.function == WRITE:
        return WriteMultipleRegistersRequest(dev_id=request.device_id, address=request.write_address, registers=words)
    return ReadWriteMultipleRegistersRequest(
        dev_id=request.device_id,
        read_address=request.read_address,
        read_count=request.read_count,
        write_address=request.write_address,
        write_registers=words,
    )


class Transport:
    """A Modbus bus (TCP, TLS or RTU): one request outstanding, a stop before everything queued, no silent repeats.

    After anything doubtful (a timeout, a cancelled caller, bytes that nobody asked for, a broken connection) the bus
    is cleaned before the next request: TCP is closed and reopened, a serial line is left alone until the slowest
    slave must have answered, and a canary read proves it.
    """

    def __init__(self, address: TcpAddress | TlsAddress | RtuAddress) -> None:
        self.address = address
        self.recoveries = 0
        self._gate = Gate()
        self._client: _Client | None = None
        self._wanted = False
        self._doubt: _Doubt | None = None
        self._canaries: dict[int, _Canary] = {}
        self._outstanding: Request | None = None
        self._sent = b""
        self._sent_s = self._heard_s = self._quiet_from_s = 0.0
        self._answer: bytes | None = None
        self._unasked = False

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""
        return self.address.name

    async def open(self) -> None:
        """Connect. Raises ConnectionLostError where that fails within the deadline."""
        self._wanted = True
        async with self._gate.hold():
            await self._connect()

    async def close(self) -> None:
        """Disconnect; requests that are still waiting fail."""
        self._wanted = False
        self._disconnect()

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Tell what ``block`` of this device always shows: it is read to prove a doubtful bus clean."""
        self._canaries[device_id] = _Canary(block.table, block.address, tuple(words))

    async def read(self, device_id: int, block: Block, *, priority: bool = False) -> Exchange:
        """Read a block. Raises WireError, or the DeviceError of the exception that came."""
        return await self.read_words(device_id, block.table, block.address, block.words, priority=priority)

    async def read_words(
        self, device_id: int, table: Table, address: int, count: int, *, priority: bool = False
    ) -> Exchange:
        """Read ``count`` words at ``address``. Raises as ``read`` does."""
        return await self._transact(read_request(device_id, table, address, count), priority)

    async def write(self, device_id: int, address: int, words: Sequence[int], *, priority: bool = False) -> Exchange:
        """Write words (function 16), once. After a WireError the device may or may not have carried it out."""
        return await self._transact(Request(device_id, WRITE, write_address=address, words=tuple(words)), priority)

    async def read_write(
        self, device_id: int, write_address: int, words: Sequence[int], read_address: int, count: int
    ) -> Exchange:
        """Write, then read holding registers, in one transaction (function 23)."""
        request = Request(device_id, READ_WRITE, read_address, count, write_address, tuple(words))
        return await self._transact(request, False)

    # ---- one transaction

    async def _transact(self, request: Request, priority: bool) -> Exchange:
        async with self._gate.hold(priority=priority):
            if not self._wanted:
                raise ConnectionLostError(f"bus {self.name}: it is closed, open it first")
            await self._line_silence()
            if self._doubt is not None or self._unasked or not self._is_connected:
                await self._recover(request)
            return await self._exchange(request)

    async def _exchange(self, request: Request) -> Exchange:
        client = self._client
        if client is None:
            raise ConnectionLostError(f"bus {self.name}: it is not connected")
        pdu = _pdu(request)
        self._outstanding, self._answer, self._unasked = request, None, False
        self._sent_s = time.monotonic()
        try:
            async with asyncio.timeout(self._deadline_s(request)):
                await client.execute(False, pdu)
            words = self._believed(request, pdu.transaction_id)
        except TimeoutError as error:
            self._doubt = _Doubt(request, self._sent_s)
            raise NoAnswerError(
                f"bus {self.name}: {request.subject}: no answer within {self._deadline_s(request):.3g} s: "
                "check the device and the wire"
            ) from error
        except (GatewayPathError, GatewayTargetError):
            raise  # a proper answer: the bus up to the gateway is clean
        except (asyncio.CancelledError, WireError):
            self._doubt = _Doubt(request, self._sent_s)
            raise
        except ModbusException as error:
            self._doubt = _Doubt(request, self._sent_s)
            lost = not self._is_connected
            raise (ConnectionLostError if lost else BadAnswerError)(
                f"bus {self.name}: {request.subject}: {error}"
            ) from error
        except (OSError, termios.error, AttributeError) as error:
            # AttributeError: pymodbus writes to a serial port that it closed itself when the line was pulled.
            self._disconnect()
            raise ConnectionLostError(f"bus {self.name}: {request.subject}: {error}: check the line") from error
        finally:
            self._outstanding = None
        return Exchange(words, self._sent_s, self._heard_s)

    def _believed(self, request: Request, transaction_id: int) -> tuple[int, ...]:
        heard = self._answer or b""
        if isinstance(self.address, RtuAddress):
            return checked_words(request, rtu_answer(request, heard))
        return checked_words(request, mbap_answer(request, transaction_id, heard))

    def _deadline_s(self, request: Request) -> float:
        return self.address.timeout_s + self._line_s(request.request_bytes) + self._line_s(request.answer_bytes)

    def _line_s(self, pdu_bytes: int) -> float:
        """Time that a frame takes on the line; nothing on TCP."""
        if not isinstance(self.address, RtuAddress):
            return 0.0
        return (pdu_bytes + _RTU_FRAME_OVERHEAD) * _CHARACTER_BITS / self.address.baud_rate

    # ---- what pymodbus tells us on the way

    def _packet(self, sending: bool, data: bytes) -> bytes:
        now_s = time.monotonic()
        if sending:
            self._sent, self._sent_s = data, now_s
            self._quiet_from_s = now_s + self._line_s(len(data) - _RTU_FRAME_OVERHEAD)
            return data
        self._quiet_from_s = now_s
        if self._outstanding is None or self._answer is not None:
            self._unasked = True
        elif isinstance(self.address, RtuAddress) and data.startswith(self._sent):
            self._fail(EchoError(f"bus {self.name}: the line returns what is sent: switch off the adapter's echo"))
        else:
            self._heard, self._heard_s = data, now_s
        return data

    def _decoded(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        if not sending and self._outstanding is not None and self._answer is None:
            self._answer = self._heard
        return pdu

    def _connection(self, connected: bool) -> None:
        if not connected:
            self._fail(ConnectionLostError(f"bus {self.name}: the connection broke: check the device and the wire"))

    def _fail(self, error: WireError) -> None:
        waiting = None if self._client is None else self._client.ctx.response_future
        if self._outstanding is not None and waiting is not None and not waiting.done():
            waiting.set_exception(error)

    # ---- connection and recovery

    @property
    def _is_connected(self) -> bool:
        return self._client is not None and self._client.connected

    def _new_client(self) -> _Client:
        address = self.address
        # retries and reconnect_delay 0: nothing may be sent or opened that was not asked for here. Its timeout is
        # never reached, the deadlines here are shorter.
        ours: dict[str, Any] = {
            "timeout": 10.0 * address.timeout_s + 60.0,
            "retries": 0,
            "reconnect_delay": 0,
            "trace_packet": self._packet,
            "trace_pdu": self._decoded,
            "trace_connect": self._connection,
        }
        if isinstance(address, RtuAddress):
            return AsyncModbusSerialClient(
                address.serial_port,
                baudrate=address.baud_rate,
                parity=address.parity.value,
                stopbits=address.stop_bits,
                **ours,
            )
        if isinstance(address, TcpAddress):
            return AsyncModbusTcpClient(address.host, port=address.port, **ours)
        context = _tls_context(address)
        client = AsyncModbusTlsClient(address.host, port=address.port, sslctx=context, **ours)
        # pymodbus' TLS framer takes every segment for a whole frame; Modbus/TCP Security frames as TCP does.
        client.ctx.framer = FramerSocket(DecodePDU(False))
        client.ctx.call_create = partial(
            asyncio.get_running_loop().create_connection,
            client.ctx.handle_new_connection,
            address.host,
            address.port,
            ssl=context,
            server_hostname=address.server_name or address.host,
        )
        return client

    async def _connect(self) -> None:
        self._disconnect()
        client = self._new_client()
        deadline_s = self.address.timeout_s + (_TLS_HANDSHAKE_S if isinstance(self.address, TlsAddress) else 0.0)
        try:
            async with asyncio.timeout(deadline_s):
                connected = await client.connect()
        except TimeoutError:
            connected = False
        except termios.error as error:
            raise ConnectionLostError(
                f"bus {self.name}: the port refuses its settings ({error}): check baud_rate, parity and stop_bits; "
                'pseudo-terminals and some adapters know no parity, then say parity = "N"'
            ) from error
        except (OSError, ModbusException) as error:
            raise ConnectionLostError(f"bus {self.name}: it cannot be opened ({error}): check the address") from error
        if not connected:
            client.close()
            where = (
                self.address.serial_port
                if isinstance(self.address, RtuAddress)
                else (f"{self.address.host}:{self.address.port}")
            )
            raise ConnectionLostError(f"bus {self.name}: {where} cannot be opened: check the address and the wire")
        self._client = client
        self._unasked = False

    def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError, termios.error, AttributeError):
                client.close()

    async def _recover(self, request: Request) -> None:
        """Make the bus trustworthy again. Raises WireError where it is not within the deadlines."""
        self.recoveries += 1
        for _ in range(_CANARY_ATTEMPTS):
            doubt = self._doubt or _Doubt(request, self._sent_s)
            self._doubt = doubt
            if not (isinstance(self.address, RtuAddress) and self._is_connected):
                await self._connect()
            if isinstance(self.address, RtuAddress):
                await self._drain(doubt.sent_s + self.address.worst_latency_s)
            try:
                if await self._canary_sings(request, doubt.request):
                    self._doubt = None
                    return
            except BadAnswerError:
                continue
        raise BadAnswerError(f"bus {self.name}: answers keep coming that nobody asked for: check for a second master")

    async def _canary_sings(self, request: Request, doubtful: Request) -> bool:
        canary = self._canaries.get(request.device_id)
        if canary is not None:
            probe = read_request(request.device_id, canary.table, canary.address, len(canary.words))
        else:
            address = request.read_address if request.is_read else request.write_address
            table = Table.INPUT if request.function == READ_INPUT else Table.HOLDING
            probe = read_request(request.device_id, table, address, 1)
        refused = False
        words: tuple[int, ...] = ()
        try:
            words = (await self._exchange(probe)).words
        except DeviceError:
            refused = True  # an exception is an answer too, though it may be the late one
        alike = refused or (probe.function, probe.read_count) == (doubtful.function, doubtful.read_count)
        if isinstance(self.address, RtuAddress) and alike:
            # It might have been the late answer: then the canary's own is still to come.
            await self._drain(self._sent_s + self.address.worst_latency_s)
        if self._unasked or (canary is not None and words != canary.words):
            self._doubt = _Doubt(probe, self._sent_s)
            return False
        return True

    async def _drain(self, until_s: float) -> None:
        """Leave a serial line alone until ``until_s`` and until it has been silent for a frame's gap.

        Raises BadAnswerError where it never falls silent.
        """
        latest_s = max(until_s, time.monotonic()) + 1.0
        while (now_s := time.monotonic()) < max(until_s, self._quiet_from_s + self._silence_s):
            if now_s > latest_s:
                raise BadAnswerError(f"bus {self.name}: the line does not fall silent: check for a second master")
            await asyncio.sleep(max(until_s, self._quiet_from_s + self._silence_s) - now_s)

    @property
    def _silence_s(self) -> float:
        if not isinstance(self.address, RtuAddress):
            return 0.0
        if self.address.baud_rate > 19200:
            return _LONGEST_SILENCE_S
        return 3.5 * _CHARACTER_BITS / self.address.baud_rate

    async def _line_silence(self) -> None:
        if isinstance(self.address, RtuAddress):
            wait_s = self._quiet_from_s + self._silence_s - time.monotonic()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
