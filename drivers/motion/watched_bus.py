"""A bus on which valves in service are read: left at once for whoever takes it, and unable to carry a write."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Final

import structlog

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress
from drivers.motion.bus_lock import is_taken, watch_name
from drivers.motion.watch_post import WatchPost
from drivers.registers import Block
from drivers.serial_gauge import Reading, SerialGauge
from drivers.transport import Exchange, ReadTransport
from valve.errors import BusyError, WireError

_LOG = structlog.get_logger(__name__)
_LOOK_AGAIN_S: Final = 2.0  # whether a bus is free that was taken before anybody watched it


class LeftError(WireError):
    """The bus was left for somebody else: that says nothing of its devices."""


class WatchedBus:
    """One bus, read one transaction at a time while nobody else has it.

    It has no method that writes, and what it sends goes through a ``ReadTransport``, which has none either.
    ``openings`` counts the connections: a device behind a new one has to prove itself again.
    """

    def __init__(self, address: BusAddress) -> None:
        self.address = address
        self.gauge = _GaugeInTurn(address, self) if isinstance(address, GaugeAddress) else None
        self._transport = None if isinstance(address, GaugeAddress) else ReadTransport(address)
        self._turn = asyncio.Lock()
        self._post = WatchPost(watch_name(address), self._leave, self._come_back)
        self._at_hand = False
        self._is_open = False
        self._quiet_from_s = 0.0  # a slave may still answer until then
        self._looking: asyncio.Task[None] | None = None
        self.openings = 0

    @property
    def at_hand(self) -> bool:
        """Whether it may be read now."""
        return self._at_hand

    async def start(self) -> None:
        """Watch it as soon as it is free. Raises BusyError where another process does already, OSError."""
        try:
            await self._post.open()
        except BusyError as error:
            raise BusyError(f"bus {self.address.name}: {error}") from error
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
        assert self._transport is not None, "a gauge has no registers"
        async with self._turn:
            self._require_at_hand()
            try:
                if not self._is_open:
                    await self._transport.open()
                    self._is_open = True
                    self.openings += 1
                return await self._transport.read(device_id, block, priority=priority)
            except WireError:
                if isinstance(self.address, RtuAddress):
                    self._quiet_from_s = time.monotonic() + self.address.worst_latency_s
                raise

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Tell what a block always shows, as ``ReadTransport.set_canary``."""
        assert self._transport is not None, "a gauge has no registers"
        self._transport.set_canary(device_id, block, words)

    async def read_gauge(self, gauge: SerialGauge) -> Reading:
        """Ask the gauge. Raises LeftError where its line is somebody else's, WireError."""
        async with self._turn:
            self._require_at_hand()
            if not self._is_open:
                await gauge.open()
                self._is_open = True
                self.openings += 1
            return await SerialGauge.read(gauge)

    def _require_at_hand(self) -> None:
        if not self._at_hand:
            raise LeftError(f"bus {self.address.name}: it is left for somebody else")

    async def _leave(self) -> None:
        """Return once nothing of ours is on the bus: behind the transaction that is in flight."""
        self._at_hand = False
        async with self._turn:
            self._is_open = False
            if self.gauge is not None:
                await self.gauge.close()
            elif self._transport is not None:
                await self._transport.close()
            quiet_s = self._quiet_from_s - time.monotonic()
            if quiet_s > 0.0:
                await asyncio.sleep(quiet_s)

    def _come_back(self) -> None:
        if self._looking is None or self._looking.done():
            self._looking = asyncio.ensure_future(self._free())

    async def _free(self) -> None:
        """Wait until nobody has the bus."""
        while self._post.is_wanted or is_taken(self.address):  # noqa: ASYNC110  - other processes have no event of ours
            await asyncio.sleep(_LOOK_AGAIN_S)
        self._at_hand = True


class _GaugeInTurn(SerialGauge):
    """A gauge that is asked in its bus's turn."""

    def __init__(self, address: GaugeAddress, bus: WatchedBus) -> None:
        super().__init__(address)
        self._bus = bus

    async def read(self, *, priority: bool = False) -> Reading:  # noqa: ARG002  - nobody goes first here
        """Ask once. Raises LeftError, WireError."""
        return await self._bus.read_gauge(self)
