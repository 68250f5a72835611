"""A bus on which valves in service are read: left at once for whoever takes it, and unable to carry a write."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Final

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress
from drivers.bus import Exchange, Reading
from drivers.faults import GatewayPathError, GatewayTargetError
from drivers.motion.bus_lock import is_taken, watch_name
from drivers.motion.watch_post import WatchPost
from drivers.registers import Block
from drivers.serial_gauge import SerialGauge
from drivers.transport import ReadTransport
from valve.errors import BusyError, WireError
from valve.messages import message_of, say

_LOOK_AGAIN_S: Final = 2.0  # whether a bus is free that was taken before anybody watched it


class LeftError(WireError):
    """The bus was left for somebody else: that says nothing of its devices."""


class WatchedBus:
    """One bus, read one transaction at a time once nobody has had it for ``after_s`` seconds.

    It has no method that writes, and what it sends goes through a ``ReadTransport``, which has none either. A bus on
    which an answer failed is closed, and begun anew by the next read: whoever takes it waits for no recovery of ours.
    ``openings`` counts the connections: a device behind a new one has to prove itself again.

    ``after_s`` lets the watchdogs of its devices act: who had the bus before may have died with a valve commanded, and
    some devices take any request for a sign of life.
    """

    def __init__(self, address: BusAddress, after_s: float = 0.0) -> None:
        self.address = address
        self.gauge = _GaugeInTurn(address, self) if isinstance(address, GaugeAddress) else None
        self._after_s = after_s
        self._transport: ReadTransport | None = None
        self._turn = asyncio.Lock()
        self._post = WatchPost(watch_name(address), self._leave, self._come_back)
        self._at_hand = False
        self._is_open = False
        self._quiet_from_s = 0.0  # a device may still answer until then
        self._looking: asyncio.Task[None] | None = None
        self.openings = 0

    @property
    def at_hand(self) -> bool:
        """Whether it may be read now."""
        return self._at_hand

    async def start(self) -> None:
        """Watch it as soon as it is free. Raises BusyError where another process does already, OSError."""
        async with self._turn:
            if self._post.is_open:
                return
            try:
                await self._post.open()
            except BusyError as error:
                raise BusyError(
                    say("bus_and_why", "bus {bus}: {why}", bus=self.address.name, why=message_of(error))
                ) from error
        self._come_back()

    async def close(self) -> None:
        """Leave it for good."""
        if self._looking is not None:
            self._looking.cancel()
        await self._leave()
        await self._post.close()
        if self._looking is not None:
            self._looking.cancel()

    async def read(self, device_id: int, block: Block, *, priority: bool = False) -> Exchange:
        """Read a block. Raises LeftError where the bus is somebody else's, WireError, DeviceError."""
        assert not isinstance(self.address, GaugeAddress), "a gauge has no registers"
        async with self._transaction():
            if self._transport is None:
                self._transport = ReadTransport(self.address)
            if not self._is_open:
                await self._transport.open()
                self._opened()
            return await self._transport.read(device_id, block, priority=priority)

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Tell what a block always shows, as ``ReadTransport.set_canary``."""
        if self._transport is not None:
            self._transport.set_canary(device_id, block, words)

    async def read_gauge(self, gauge: SerialGauge) -> Reading:
        """Ask the gauge. Raises LeftError where its line is somebody else's, WireError."""
        async with self._transaction():
            if not self._is_open:
                await gauge.open()
                self._opened()
            return await SerialGauge.read(gauge)

    @asynccontextmanager
    async def _transaction(self) -> AsyncIterator[None]:
        """Hold the bus's turn while one is made. A wire that failed, or a reader that was cancelled, ends it closed."""
        async with self._turn:
            await self._quiet()
            self._require_at_hand()
            try:
                yield
            except (LeftError, GatewayPathError, GatewayTargetError):
                raise  # nothing of it is under way
            except (WireError, asyncio.CancelledError):
                self._quiet_from_s = time.monotonic() + self._answers_within_s
                await self._hang_up()
                raise

    @property
    def _answers_within_s(self) -> float:
        """How long after its deadline an answer may still come where others would hear it, s."""
        if isinstance(self.address, RtuAddress):
            return self.address.worst_latency_s
        return self.address.timeout_s if isinstance(self.address, GaugeAddress) else 0.0

    def _opened(self) -> None:
        self._is_open = True
        self.openings += 1
        self._require_at_hand()  # somebody may have come for it meanwhile

    def _require_at_hand(self) -> None:
        if not self._at_hand:
            raise LeftError(say("bus_left", "bus {bus}: it is left for somebody else", bus=self.address.name))

    async def _hang_up(self) -> None:
        transport, self._transport, self._is_open = self._transport, None, False
        if transport is not None:
            await transport.close()
        if self.gauge is not None:
            await self.gauge.close()

    async def _quiet(self) -> None:
        quiet_s = self._quiet_from_s - time.monotonic()
        if quiet_s > 0.0:
            await asyncio.sleep(quiet_s)

    async def _leave(self) -> None:
        """Return once nothing of ours is on the bus: behind the transaction that is in flight."""
        self._at_hand = False
        async with self._turn:
            await self._hang_up()
            await self._quiet()

    def _come_back(self) -> None:
        if self._looking is not None:
            self._looking.cancel()
        self._looking = asyncio.ensure_future(self._free())

    async def _free(self) -> None:
        """Wait until nobody has had the bus for as long as it takes."""
        free_from_s: float | None = None
        while True:
            if self._post.is_wanted or is_taken(self.address):
                free_from_s, wait_s = None, _LOOK_AGAIN_S
            else:
                now_s = time.monotonic()
                free_from_s = now_s if free_from_s is None else free_from_s
                wait_s = min(_LOOK_AGAIN_S, free_from_s + self._after_s - now_s)
            if wait_s <= 0.0:
                break
            await asyncio.sleep(wait_s)
        self._at_hand = True


class _GaugeInTurn(SerialGauge):
    """A gauge that is asked in its bus's turn."""

    def __init__(self, address: GaugeAddress, bus: WatchedBus) -> None:
        super().__init__(address)
        self._bus = bus

    async def read(self, *, priority: bool = False) -> Reading:  # noqa: ARG002  - nobody goes first here
        """Ask once. Raises LeftError, WireError."""
        return await self._bus.read_gauge(self)
