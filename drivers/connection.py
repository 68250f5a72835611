"""One connection to a bus, and one request on it at a time: pymodbus makes its frame and carries it.

The one module that speaks to pymodbus' client, and by what that documents alone: it sends without waiting for an answer
and shows each byte that comes. What came is judged here: only a checked answer is believed, until a deadline. When to
connect, what to do after a doubtful exchange and who comes next is decided by ``drivers.transport``.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import ssl
import termios
import time
from typing import Any, Final

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient, AsyncModbusTlsClient
from pymodbus.exceptions import ModbusException

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
    mbap_answer_in,
    rtu_answer,
    rtu_answer_in,
    rtu_damage,
    without_echo,
)
from drivers.serial_port import refusal_of, why_not_opened
from valve.errors import ConfigurationError, WireError
from valve.messages import message_of, say

_CHARACTER_BITS: Final = 11  # start, eight data, parity or second stop, stop (Modbus over Serial Line 1.02, 2.5.1)
_LONGEST_SILENCE_S: Final = 1.75e-3  # the gap above 19200 baud (the same, 2.5.1.1)
_TLS_HANDSHAKE_S: Final = 2.0  # on top of the transaction's deadline: two certificates are checked
_WHY_S: Final = 0.2  # to learn why a port cannot be opened: who waits for the bus may be about to make a valve safe
_RTU_FRAME_OVERHEAD: Final = 3
_PIECE_S: Final = 0.02  # a USB adapter hands on what came every 16 ms: after so long an answer has no more pieces

# What pymodbus would print is said by the errors here; who configures logging still gets it.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())

_Client = AsyncModbusTcpClient | AsyncModbusSerialClient


class _NamedContext(ssl.SSLContext):
    """Asks for the name that the certificate shows, which need not be the address: pymodbus hands on the address."""

    asked: str

    def wrap_bio(
        self,
        incoming: ssl.MemoryBIO,
        outgoing: ssl.MemoryBIO,
        server_side: bool = False,
        server_hostname: str | bytes | None = None,
        session: ssl.SSLSession | None = None,
    ) -> ssl.SSLObject:
        """Return the TLS side of a connection, as ``ssl.SSLContext`` does."""
        return super().wrap_bio(incoming, outgoing, server_side, self.asked or server_hostname, session)


def _tls_context(address: TlsAddress) -> ssl.SSLContext:
    context = _NamedContext(ssl.PROTOCOL_TLS_CLIENT)  # it demands a certificate, and that it is of the name
    context.asked = address.server_name or ""
    try:
        context.verify_flags = ssl.create_default_context(cafile=address.ca_file).verify_flags
        context.load_verify_locations(address.ca_file)
        if address.certificate_file is not None:
            context.load_cert_chain(address.certificate_file, address.key_file)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(
            say(
                "certificates_unusable",
                "bus {bus}: its certificates cannot be used ({why}): check the files",
                bus=address.name,
                why=message_of(error),
            )
        ) from error
    return context


async def _send(client: _Client, request: Request) -> None:
    """Send a request once, at once: with ``no_response_expected`` pymodbus waits for nothing."""
    device: dict[str, Any] = {"device_id": request.device_id, "no_response_expected": True}
    words = list(request.words)
    if request.function == READ_HOLDING:
        await client.read_holding_registers(request.read_address, count=request.read_count, **device)
    elif request.function == READ_INPUT:
        await client.read_input_registers(request.read_address, count=request.read_count, **device)
    elif request.function == WRITE_ONE:
        await client.write_register(request.write_address, words[0], **device)
    elif request.function == WRITE:
        await client.write_registers(request.write_address, words, **device)
    else:
        await client.readwrite_registers(
            read_address=request.read_address,
            read_count=request.read_count,
            write_address=request.write_address,
            values=words,
            **device,
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
        self._answered: asyncio.Future[bytes] | None = None  # the frame of the answer to it
        self._transaction_id = 0
        self._sent = b""
        self._pieces: list[bytes] = []  # what had come at each time since the request went out
        self._quiet: asyncio.TimerHandle | None = None  # judges what came once a serial line is quiet
        self._tls: tuple[list[tuple[int, int]], ssl.SSLContext] | None = None  # its files' times and sizes

    @property
    def _subject(self) -> str:
        return say("bus_named", "bus {bus}", bus=self.address.name)

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
            raise ConfigurationError(self._of_bus(fault))
        client = self._client
        if client is None:
            raise ConnectionLostError(say("bus_not_connected", "{subject}: it is not connected", subject=self._subject))
        if not client.connected:
            raise ConnectionLostError(
                say(
                    "connection_broke",
                    "{subject}: {asked}: the connection broke: check the wire",
                    subject=self._subject,
                    asked=request.subject,
                )
            )
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[bytes] = loop.create_future()
        waits_s = self.deadline_s(request) if within_s is None else within_s
        late = loop.call_later(waits_s, self._late, answered, request)
        self._outstanding, self._answered, self.unasked, self._pieces = request, answered, False, []
        self.sent_s = time.monotonic()
        try:
            await _send(client, request)
            frame = await answered
            self.answers += 1
            return self._believed(request, frame)
        except ModbusException as error:
            lost = not self.is_open
            raise (ConnectionLostError if lost else BadAnswerError)(
                say(
                    "transaction_failed",
                    "{subject}: {asked}: {why}",
                    subject=self._subject,
                    asked=request.subject,
                    why=message_of(error),
                )
            ) from error
        except (OSError, termios.error, AttributeError) as error:
            # AttributeError: pymodbus writes to a serial port that it closed itself when the line was pulled.
            self.close()
            raise ConnectionLostError(
                say(
                    "line_failed",
                    "{subject}: {asked}: {why}: check the line",
                    subject=self._subject,
                    asked=request.subject,
                    why=message_of(error),
                )
            ) from error
        finally:
            late.cancel()
            self._forget_quiet()
            self._outstanding = self._answered = None

    def _late(self, answered: asyncio.Future[bytes], request: Request) -> None:
        if answered.done():
            return
        is_serial = isinstance(self.address, RtuAddress)
        came = instead_of_answer(request, None if is_serial else self._transaction_id, self._pieces)
        late = say(
            "no_answer_within",
            "{subject}: {asked}: no answer within {time:.3g s}",
            subject=self._subject,
            asked=request.subject,
            time=self.deadline_s(request),
        )
        if came:
            answered.set_exception(OtherAnswerError(say("late_but_came", "{late}, but {came}", late=late, came=came)))
            return
        answered.set_exception(NoAnswerError(say("no_answer", "{late}: check the device and the wire", late=late)))

    def _believed(self, request: Request, frame: bytes) -> tuple[int, ...]:
        is_serial = isinstance(self.address, RtuAddress)
        try:
            answer = rtu_answer(request, frame) if is_serial else mbap_answer(request, self._transaction_id, frame)
            return checked_words(request, answer)
        except BadAnswerError as error:
            raise BadAnswerError(self._of_bus(message_of(error))) from None

    def _of_bus(self, what: str) -> str:
        return say("of_bus", "{subject}: {what}", subject=self._subject, what=what)

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
        """Note what goes out; judge all that came since then, and leave pymodbus nothing to decode."""
        now_s = time.monotonic()
        is_serial = isinstance(self.address, RtuAddress)
        if sending:
            self._sent, self.sent_s = data, now_s
            self._transaction_id = 0 if is_serial else int.from_bytes(data[:2], "big")
            self.quiet_from_s = now_s + self._line_s(len(data) - _RTU_FRAME_OVERHEAD)
            return data
        self.quiet_from_s = now_s
        request, answered = self._outstanding, self._answered
        if request is None or answered is None or answered.done():
            self.unasked = True
            return b""
        self.heard_s = now_s
        self._pieces.append(data)
        if isinstance(self.address, RtuAddress):
            frame, foreign = self._on_line(request, data, echo=self.address.echo), 0
        else:
            frame, foreign = mbap_answer_in(request, self._transaction_id, data)
        if frame and not answered.done():
            answered.set_result(frame)
        # Whole frames that answer something else it passes over, and forgets: its buffer holds two long ones.
        return data[:foreign]

    def _on_line(self, request: Request, line: bytes, *, echo: bool) -> bytes:
        """Return the answer's frame once it has come on a serial line, b"" until then."""
        self._forget_quiet()
        heard: bytes | None = line
        try:
            if echo:
                heard = without_echo(self._sent, line)
            elif request.function != WRITE_ONE and is_echo(self._sent, line):
                raise EchoError(
                    say(
                        "line_echoes",
                        "the line returns what is sent: switch off the adapter's echo, or say echo = true",
                    )
                )
        except EchoError as error:
            self._fail(EchoError(self._of_bus(message_of(error))))
            return b""
        if not heard:
            return b""
        frame = rtu_answer_in(request, heard)
        if not frame:
            if heard is not line:
                self._pieces.append(heard)
            wait_s = max(_PIECE_S, self.silence_s)
            self._quiet = asyncio.get_running_loop().call_later(wait_s, self._judge_line, request, heard)
        return frame

    def _judge_line(self, request: Request, heard: bytes) -> None:
        """End a request whose answer came damaged: no more of it is under way."""
        damage = rtu_damage(request, heard)
        if damage is not None:
            self._fail(type(damage)(self._of_bus(message_of(damage))))

    def _forget_quiet(self) -> None:
        if self._quiet is not None:
            self._quiet.cancel()
            self._quiet = None

    def _connection(self, connected: bool) -> None:
        if not connected:
            self._gone.set()
            self._fail(
                ConnectionLostError(
                    say(
                        "device_connection_broke",
                        "{subject}: the connection broke: check the device and the wire",
                        subject=self._subject,
                    )
                )
            )

    def _fail(self, error: WireError) -> None:
        if self._answered is not None and not self._answered.done():
            self._answered.set_exception(error)

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
        return AsyncModbusTlsClient(address.host, port=address.port, sslctx=self._certificates(address), **ours)

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

    async def open(self) -> None:
        """Connect anew. Raises ConnectionLostError where that fails within the deadline."""
        self.close()
        client = self._new_client()
        self._gone.clear()
        deadline_s = self.address.timeout_s + (_TLS_HANDSHAKE_S if isinstance(self.address, TlsAddress) else 0.0)
        connected = False
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(deadline_s):
                    connected = await client.connect()
        except termios.error as error:
            raise ConnectionLostError(
                say(
                    "port_refuses_settings",
                    "{subject}: the port refuses its settings ({why}): check baud_rate, parity and stop_bits; "
                    'pseudo-terminals and some adapters know no parity, then say parity = "N"',
                    subject=self._subject,
                    why=message_of(error),
                )
            ) from error
        except (OSError, ModbusException) as error:
            raise ConnectionLostError(
                say(
                    "bus_cannot_be_opened",
                    "{subject}: it cannot be opened ({why}): check the address",
                    subject=self._subject,
                    why=message_of(error),
                )
            ) from error
        finally:
            if not connected:  # also one that came about as the time was over
                client.close()
        if not connected:
            reason: str = say("check_address_and_wire", "check the address and the wire")
            if isinstance(self.address, RtuAddress):
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_WHY_S):
                        reason = await asyncio.to_thread(self._why_not_opened)
            raise ConnectionLostError(
                say(
                    "place_cannot_be_opened",
                    "{subject}: {place} cannot be opened: {reason}",
                    subject=self._subject,
                    place=self._place,
                    reason=reason,
                )
            )
        self._client = client
        self.unasked, self.answers = False, 0

    def _why_not_opened(self) -> str:
        return why_not_opened(self._place, refusal_of(self._place))  # pymodbus tells its log alone

    def close(self) -> None:
        """Disconnect, if there is a connection."""
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError, termios.error, AttributeError):
                client.close()
