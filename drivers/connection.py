"""One connection to a bus, and one request on it at a time, carried by pymodbus.

The one module that speaks to pymodbus' client. It sends, waits until a deadline and believes only a checked answer;
when to connect, what to do after a doubtful exchange and who comes next is decided by ``drivers.transport``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import ssl
import termios
import time
from collections.abc import Awaitable, Callable
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
    WriteSingleRegisterRequest,
)

from drivers.addresses import RtuAddress, TcpAddress, TlsAddress
from drivers.faults import BadAnswerError, ConnectionLostError, EchoError, NoAnswerError, OtherAnswerError
from drivers.frames import (
    READ_HOLDING,
    READ_INPUT,
    WRITE,
    WRITE_ONE,
    Request,
    checked_words,
    instead_of_answer,
    is_echo,
    mbap_answer,
    rtu_answer,
    rtu_answer_in,
    rtu_damage,
    without_echo,
)
from drivers.serial_port import why_not_opened
from valve.errors import ConfigurationError, WireError

_CHARACTER_BITS: Final = 11  # start, eight data, parity or second stop, stop (Modbus over Serial Line 1.02, 2.5.1)
_LONGEST_SILENCE_S: Final = 1.75e-3  # the gap above 19200 baud (the same, 2.5.1.1)
_TLS_HANDSHAKE_S: Final = 2.0  # on top of the transaction's deadline: two certificates are checked
_WHY_S: Final = 0.2  # to learn why a port cannot be opened: who waits for the bus may be about to make a valve safe
_RTU_FRAME_OVERHEAD: Final = 3
_PIECE_S: Final = 0.02  # a USB adapter hands on what came every 16 ms: after so long an answer has no more pieces

# What pymodbus would print is said by the errors here; who configures logging still gets it.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

_Client = AsyncModbusTcpClient | AsyncModbusSerialClient


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
    if request.function == WRITE_ONE:
        return WriteSingleRegisterRequest(dev_id=request.device_id, address=request.write_address, registers=words)
    if request.function == WRITE:
        return WriteMultipleRegistersRequest(dev_id=request.device_id, address=request.write_address, registers=words)
    return ReadWriteMultipleRegistersRequest(
        dev_id=request.device_id,
        read_address=request.read_address,
        read_count=request.read_count,
        write_address=request.write_address,
        write_registers=words,
    )


class Connection:
    """What pymodbus opens at an address. One request is outstanding at a time: the caller sees to it.

    ``unasked`` tells that bytes came which no request was waiting for; ``answers`` how many requests were answered
    since it was opened; ``sent_s`` and ``heard_s`` when the last request went out and its answer was there;
    ``quiet_from_s`` since when a serial line carries nothing (monotonic).
    """

    def __init__(self, address: TcpAddress | TlsAddress | RtuAddress) -> None:
        self.address = address
        self.unasked = False
        self.answers = 0
        self.sent_s = self.heard_s = self.quiet_from_s = 0.0
        self._gone = asyncio.Event()  # the connection ended
        self._client: _Client | None = None
        self._outstanding: Request | None = None
        self._transaction_id = 0
        self._sent = self._heard = b""
        self._pieces: list[bytes] = []  # what came since the request went out
        self._line = b""  # the same on a serial line, as a whole
        self._quiet: asyncio.TimerHandle | None = None  # judges what came once a serial line is quiet
        self._answer: bytes | None = None
        self._refused: OSError | None = None  # why the last opening failed
        self._tls: tuple[list[tuple[int, int]], ssl.SSLContext] | None = None  # its files' times and sizes

    @property
    def _subject(self) -> str:
        return f"bus {self.address.name}"

    @property
    def _place(self) -> str:
        if isinstance(self.address, RtuAddress):
            return self.address.serial_port
        return f"{self.address.host}:{self.address.port}"

    @property
    def is_open(self) -> bool:
        """Whether there is a connection."""
        return self._client is not None and self._client.connected

    async def ends_before(self, until_s: float) -> bool:
        """Whether the other end closes the connection before a time of the monotonic clock; wait for it until then."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(until_s - time.monotonic()):
                await self._gone.wait()
        return not self.is_open

    @property
    def silence_s(self) -> float:
        """Gap that ends a frame on a serial line (t3.5), s; 0 on TCP."""
        if not isinstance(self.address, RtuAddress):
            return 0.0
        if self.address.baud_rate > 19200:
            return _LONGEST_SILENCE_S
        return 3.5 * _CHARACTER_BITS / self.address.baud_rate

    async def exchange(self, request: Request, within_s: float | None = None) -> tuple[int, ...]:
        """Send a request once and return the words of its answer, none for a write.

        It waits for ``within_s``, by default for ``deadline_s``. Raises WireError where no believable answer came, or
        the error of the exception that came.
        """
        fault = self.address.device_id_fault(request.device_id)
        if fault:
            raise ConfigurationError(f"{self._subject}: {fault}")
        client = self._client
        if client is None:
            raise ConnectionLostError(f"{self._subject}: it is not connected")
        if client.ctx.transport is None:
            raise ConnectionLostError(f"{self._subject}: {request.subject}: the connection broke: check the wire")
        loop = asyncio.get_running_loop()
        pdu = _pdu(request)
        answered: asyncio.Future[ModbusPDU] = loop.create_future()
        waits_s = self.deadline_s(request) if within_s is None else within_s
        late = loop.call_later(waits_s, self._late, answered, request)
        self._outstanding, self._answer, self.unasked, self._pieces, self._line = request, None, False, [], b""
        self.sent_s = time.monotonic()
        try:
            # What pymodbus' own execute does, with one deadline and no repeats: ours, who comes next is decided above.
            pdu.transaction_id = self._transaction_id = client.ctx.getNextTID()
            client.ctx.recv_buffer, client.ctx.response_future = b"", answered
            client.ctx.pdu_send(pdu)
            await answered
            self.answers += 1
            return self._believed(request, pdu.transaction_id)
        except ModbusException as error:
            lost = not self.is_open
            raise (ConnectionLostError if lost else BadAnswerError)(
                f"{self._subject}: {request.subject}: {error}"
            ) from error
        except (OSError, termios.error, AttributeError) as error:
            # AttributeError: pymodbus writes to a serial port that it closed itself when the line was pulled.
            self.close()
            raise ConnectionLostError(f"{self._subject}: {request.subject}: {error}: check the line") from error
        finally:
            late.cancel()
            self._forget_quiet()
            self._outstanding = None

    def _late(self, answered: asyncio.Future[ModbusPDU], request: Request) -> None:
        if answered.done():
            return
        # pymodbus drops a frame of another device or transaction before anybody sees it.
        is_serial = isinstance(self.address, RtuAddress)
        came = instead_of_answer(request, None if is_serial else self._transaction_id, self._pieces)
        late = f"{self._subject}: {request.subject}: no answer within {self.deadline_s(request):.3g} s"
        answered.set_exception(
            OtherAnswerError(f"{late}, but {came}") if came else NoAnswerError(f"{late}: check the device and the wire")
        )

    def _believed(self, request: Request, transaction_id: int) -> tuple[int, ...]:
        heard, is_serial = self._answer or b"", isinstance(self.address, RtuAddress)
        try:
            answer = rtu_answer(request, heard) if is_serial else mbap_answer(request, transaction_id, heard)
            return checked_words(request, answer)
        except BadAnswerError as error:
            raise BadAnswerError(f"{self._subject}: {error}") from None

    def deadline_s(self, request: Request) -> float:
        """Longest time from a request to its answer, s, the time on the line included."""
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
            self._sent, self.sent_s = data, now_s
            self.quiet_from_s = now_s + self._line_s(len(data) - _RTU_FRAME_OVERHEAD)
            return data
        self.quiet_from_s = now_s
        if self._outstanding is None or self._answer is not None:
            self.unasked = True
        else:
            self._heard, self.heard_s = data, now_s
            self._pieces.append(data)
        return data

    def _framed(self, framed: Callable[..., int], data: bytes, addr: object = None) -> int:
        """Let pymodbus find its answer; a frame that it cannot read fails the request and not the event loop."""
        if isinstance(self.address, RtuAddress) and self._outstanding is not None and self._answer is None:
            used = len(data)
            data = self._on_line(self._outstanding, data, echo=self.address.echo)
            if data:
                self._framed_alone(framed, data, addr)
            return used
        return self._framed_alone(framed, data, addr)

    def _on_line(self, request: Request, data: bytes, *, echo: bool) -> bytes:
        """Return the answer's frame once it has come on a serial line, b"" until then.

        The line's own frames are found here: pymodbus takes a stray byte for the device, and throws the rest away.
        """
        self.quiet_from_s = time.monotonic()
        self._line += data
        self._forget_quiet()
        heard: bytes | None = self._line
        try:
            if echo:
                heard = without_echo(self._sent, self._line)
            elif request.function != WRITE_ONE and is_echo(self._sent, self._line):
                raise EchoError("the line returns what is sent: switch off the adapter's echo, or say echo = true")
        except EchoError as error:
            self._pieces.append(self._line)
            self._fail(EchoError(f"{self._subject}: {error}"))
            return b""
        if not heard:
            return b""
        frame = rtu_answer_in(request, heard)
        if not frame:
            self._pieces.append(heard)
            wait_s = max(_PIECE_S, self.silence_s)
            self._quiet = asyncio.get_running_loop().call_later(wait_s, self._judge_line, request, heard)
        return frame

    def _judge_line(self, request: Request, heard: bytes) -> None:
        """End a request whose answer came damaged: no more of it is under way."""
        damage = rtu_damage(request, heard)
        if damage is not None:
            self._fail(type(damage)(f"{self._subject}: {damage}"))

    def _forget_quiet(self) -> None:
        if self._quiet is not None:
            self._quiet.cancel()
            self._quiet = None

    def _framed_alone(self, framed: Callable[..., int], data: bytes, addr: object) -> int:
        try:
            return framed(data, addr=addr)
        except ModbusException as error:
            self._fail(BadAnswerError(f"{self._subject}: an answer cannot be read ({error}): check the wire"))
            return len(data)

    def _decoded(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        if not sending and self._outstanding is not None and self._answer is None:
            self._answer = self._heard
        return pdu

    def _connection(self, connected: bool) -> None:
        if not connected:
            self._gone.set()
            self._fail(ConnectionLostError(f"{self._subject}: the connection broke: check the device and the wire"))

    def _fail(self, error: WireError) -> None:
        waiting = None if self._client is None else self._client.ctx.response_future
        if self._outstanding is not None and waiting is not None and not waiting.done():
            waiting.set_exception(error)

    # ---- open and close

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
        context = self._certificates(address)
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

    def _certificates(self, address: TlsAddress) -> ssl.SSLContext:
        """Read them once, and anew where a file has changed: a bus is opened again in the middle of a test.

        While they are being replaced the former ones serve. Raises ConfigurationError where none could be read yet.
        """
        files = (address.ca_file, address.certificate_file, address.key_file)
        try:
            stamps = [(one.st_mtime_ns, one.st_size) for one in map(os.stat, filter(None, files))]
            if self._tls is None or self._tls[0] != stamps:
                self._tls = stamps, _tls_context(address)
        except (OSError, ConfigurationError):
            if self._tls is None:
                return _tls_context(address)
        return self._tls[1]

    async def _created(self, create: Callable[[], Awaitable[Any]]) -> Any:
        """Open, and keep why that failed: pymodbus tells its log alone."""
        self._refused = None
        try:
            return await create()
        except OSError as error:
            self._refused = error
            raise

    async def open(self) -> None:
        """Connect anew. Raises ConnectionLostError where that fails within the deadline."""
        self.close()
        client = self._new_client()
        self._gone.clear()
        framed = client.ctx.callback_data
        client.ctx.callback_data = partial(self._framed, framed)  # type: ignore[method-assign]  # it has no other place
        client.ctx.call_create = partial(self._created, client.ctx.call_create)
        deadline_s = self.address.timeout_s + (_TLS_HANDSHAKE_S if isinstance(self.address, TlsAddress) else 0.0)
        try:
            async with asyncio.timeout(deadline_s):
                connected = await client.connect()
        except TimeoutError:
            connected = False
        except termios.error as error:
            raise ConnectionLostError(
                f"{self._subject}: the port refuses its settings ({error}): check baud_rate, parity and stop_bits; "
                'pseudo-terminals and some adapters know no parity, then say parity = "N"'
            ) from error
        except (OSError, ModbusException) as error:
            raise ConnectionLostError(f"{self._subject}: it cannot be opened ({error}): check the address") from error
        finally:
            if not client.connected:
                client.close()
        if not connected:
            reason = "check the address and the wire"
            if isinstance(self.address, RtuAddress):
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_WHY_S):
                        reason = await asyncio.to_thread(why_not_opened, self._place, self._refused)
            raise ConnectionLostError(f"{self._subject}: {self._place} cannot be opened: {reason}")
        self._client = client
        self.unasked, self.answers = False, 0

    def close(self) -> None:
        """Disconnect, if there is a connection."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError, termios.error, AttributeError):
                client.close()
