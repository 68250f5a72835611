"""One bus: requests go out one at a time, each with its own deadline, and only a checked answer comes back.

Order, recovery and who comes first are decided here: what carries the bytes would repeat writes, take a late answer for
the next one and let a stop wait behind its queue.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drivers.addresses import RtuAddress, TcpAddress, TlsAddress
from drivers.bus import Exchange
from drivers.bus_queue import BusQueue
from drivers.connection import Connection
from drivers.faults import (
    BadAnswerError,
    ConnectionLostError,
    GarbledError,
    GatewayPathError,
    GatewayTargetError,
)
from drivers.frames import (
    READ_INPUT,
    READ_WRITE,
    WRITE,
    WRITE_ONE,
    Request,
    read_request,
)
from drivers.registers import Block, Table
from valve.errors import DeviceError, WireError
from valve.messages import say

_HANGS_UP_S: Final = 0.05  # a device that closes after each answer does so at once; a network's way back is shorter
_LEAST_LEFT: Final = 0.5  # of a read's deadline must be left to ask again: a slow answer must not come after it


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


class ReadTransport:
    """A Modbus bus (TCP, TLS or RTU) that is read: one request outstanding, a stop before everything queued.

    It has no way to write: ``Transport`` adds it. Nothing is repeated silently.

    After anything doubtful (a timeout, a cancelled caller, bytes that nobody asked for, a broken connection) the bus
    is cleaned before the next request: TCP is closed and reopened, a serial line is left alone until the slowest
    slave must have answered, and a canary read proves it. A TCP device that closes the connection after each answer is
    connected anew for each request, at most twice: for its canary, where it has one, and for the request.
    """

    def __init__(self, address: TcpAddress | TlsAddress | RtuAddress) -> None:
        self.address = address
        self.recoveries = 0
        self._queue = BusQueue()
        self._connection = Connection(address)
        self._wanted = False
        self._hangs_up: bool | None = None  # whether the device closes after each answer; None: nobody knows yet
        self._doubt: _Doubt | None = None
        self._canaries: dict[int, _Canary] = {}

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""
        return self.address.name

    @property
    def lost_answer_s(self) -> float:
        """Longest time that one lost answer costs, s: its deadline, and what a serial line is left alone for then."""
        address = self.address
        if isinstance(address, RtuAddress):
            return 2.0 * max(address.worst_latency_s, address.timeout_s)
        return address.timeout_s

    async def open(self) -> None:
        """Connect. Raises ConnectionLostError where that fails within the deadline."""
        self._wanted, self._hangs_up = True, None
        async with self._queue.hold():
            await self._connection.open()

    async def close(self) -> None:
        """Disconnect; requests that are still waiting fail."""
        self._wanted = False
        self._connection.close()

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

    # ---- one transaction

    async def _transact(self, request: Request, priority: bool) -> Exchange:
        async with self._queue.hold(priority=priority):
            if not self._wanted:
                raise ConnectionLostError(say("bus_closed", "bus {bus}: it is closed, open it first", bus=self.name))
            await self._line_silence()
            await self._hang_up()
            if not self._is_clean(request):
                await self._connect_anew(request)
            self._note(request)
            return await self._exchange(request)

    def _note(self, request: Request) -> None:
        """Note a request that is about to go out."""

    def _is_clean(self, request: Request) -> bool:
        connection = self._connection
        if self._doubt is not None or connection.unasked or not connection.is_open:
            return False
        # An answer to function 6 looks like the request's own echo: a read must have shown that the line has none.
        return not (request.function == WRITE_ONE and isinstance(self.address, RtuAddress) and connection.answers == 0)

    async def _exchange(self, request: Request) -> Exchange:
        connection = self._connection
        try:
            words, sent_s = await self._answered(request)
        except (GatewayPathError, GatewayTargetError):
            raise  # a proper answer: the bus up to the gateway is clean
        except (asyncio.CancelledError, WireError):
            self._doubt = _Doubt(request, connection.sent_s)
            raise
        return Exchange(words, sent_s, connection.heard_s)

    async def _answered(self, request: Request) -> tuple[tuple[int, ...], float]:
        """Words of the answer, and when the request went out first.

        A read whose answer came damaged is asked again while its own deadline lasts, as the device has answered
        already and nothing is under way: that leaves the bus clean for a stop that waits, sooner than a recovery
        would. The interval of the sample begins with the first request. Writes go out once.
        """
        connection, first_s, within_s = self._connection, math.nan, None
        while True:
            try:
                words = await connection.exchange(request, within_s)
            except GarbledError:
                first_s = connection.sent_s if math.isnan(first_s) else first_s
                await self._line_silence()
                within_s = first_s + connection.deadline_s(request) - time.monotonic()
                in_time = within_s >= _LEAST_LEFT * connection.deadline_s(request)
                if request.words or connection.unasked or not in_time:
                    raise
            else:
                return words, connection.sent_s if math.isnan(first_s) else first_s

    # ---- recovery

    async def _hang_up(self) -> None:
        """Let a device close the connection that does so after each answer: a request must not meet its farewell."""
        connection = self._connection
        if self._doubt is None and connection.answers == 1 and self._hangs_up is not False:
            is_serial = isinstance(self.address, RtuAddress)
            self._hangs_up = not is_serial and await connection.ends_before(connection.heard_s + _HANGS_UP_S)

    async def _connect_anew(self, request: Request) -> None:
        """Make the bus fit for a request. Raises WireError where it is not, within its deadlines."""
        connection = self._connection
        in_order = self._hangs_up and self._doubt is None and not connection.unasked and not connection.is_open
        if in_order and request.device_id not in self._canaries:
            await connection.open()
            return
        await self._recover(request)
        await self._hang_up()
        if not connection.is_open:
            await connection.open()

    async def _recover(self, request: Request) -> None:
        """Make the bus trustworthy again, by one attempt. Raises WireError where it is not, within its deadlines.

        Whoever asks next makes the next attempt: a stop that waits for the bus waits for one opening at most.
        """
        self.recoveries += 1
        self._doubt = doubt = self._doubt or _Doubt(request, self._connection.sent_s)
        if not (isinstance(self.address, RtuAddress) and self._connection.is_open):
            await self._connection.open()
        if isinstance(self.address, RtuAddress):
            await self._drain(doubt.sent_s + self.address.worst_latency_s)
        if not await self._canary_sings(request, doubt.request):
            raise BadAnswerError(
                say(
                    "answer_unasked",
                    "bus {bus}: an answer came that nobody asked for: check for a second master, and device_id",
                    bus=self.name,
                )
            )
        self._doubt = None

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
            await self._drain(self._connection.sent_s + self.address.worst_latency_s)
        if self._connection.unasked or (canary is not None and words != canary.words):
            self._doubt = _Doubt(probe, self._connection.sent_s)
            return False
        return True

    async def _drain(self, until_s: float) -> None:
        """Leave a serial line alone until ``until_s`` and until it has been silent for a frame's gap.

        Raises BadAnswerError where it never falls silent.
        """
        latest_s = max(until_s, time.monotonic()) + 1.0
        while (now_s := time.monotonic()) < max(until_s, self._connection.quiet_from_s + self._connection.silence_s):
            if now_s > latest_s:
                raise BadAnswerError(
                    say(
                        "line_not_silent",
                        "bus {bus}: the line does not fall silent: check for a second master",
                        bus=self.name,
                    )
                )
            await asyncio.sleep(max(until_s, self._connection.quiet_from_s + self._connection.silence_s) - now_s)

    async def _line_silence(self) -> None:
        if isinstance(self.address, RtuAddress):
            wait_s = self._connection.quiet_from_s + self._connection.silence_s - time.monotonic()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)


class Transport(ReadTransport):
    """A Modbus bus that is read and written. A write goes out once, whatever becomes of its answer."""

    def __init__(self, address: TcpAddress | TlsAddress | RtuAddress) -> None:
        super().__init__(address)
        self.writes = 0  # requests that were sent

    def _note(self, request: Request) -> None:
        self.writes += bool(request.words)

    async def write(
        self, device_id: int, address: int, words: Sequence[int], *, priority: bool = False, function: int = WRITE
    ) -> Exchange:
        """Write words, once, by function 16, or 6 for one word alone.

        After a WireError the device may or may not have carried it out.
        """
        request = Request(device_id, function, write_address=address, words=tuple(words))
        return await self._transact(request, priority)

    async def read_write(
        self, device_id: int, write_address: int, words: Sequence[int], read_address: int, count: int
    ) -> Exchange:
        """Write, then read holding registers, in one transaction (function 23)."""
        request = Request(device_id, READ_WRITE, read_address, count, write_address, tuple(words))
        return await self._transact(request, False)
