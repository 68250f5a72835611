"""A bus as the rest of the drivers needs it, whatever carries its bytes; nothing here can open one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NoReturn, Protocol, TypeAlias, TypeVar

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress, TcpAddress, TlsAddress
from drivers.faults import ConnectionLostError
from drivers.frames import WRITE
from drivers.registers import Block, Table
from valve.messages import say

if TYPE_CHECKING:
    from typing_extensions import TypeIs

ModbusAddress: TypeAlias = TcpAddress | TlsAddress | RtuAddress
_Address = TypeVar("_Address", bound=BusAddress)


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request that was answered: the words that came, and when it went out and the answer was there (monotonic)."""

    words: tuple[int, ...]
    sent_s: float
    received_s: float


@dataclass(frozen=True, slots=True)
class Reading:
    """A gauge's position and the interval in which it was taken (monotonic clock)."""

    value_m: float
    sent_s: float
    received_s: float


class Modbus(Protocol):
    """A Modbus bus, one transaction at a time, a stop before everything queued (``drivers.transport``)."""

    @property
    def address(self) -> ModbusAddress:
        """Where it is."""

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""

    @property
    def lost_answer_s(self) -> float:
        """Longest time that one lost answer costs, s."""

    @property
    def writes(self) -> int:
        """Requests to write that were sent."""

    async def open(self) -> None:
        """Connect. Raises ConnectionLostError."""

    async def close(self) -> None:
        """Disconnect."""

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Tell what a block of this device always shows."""

    async def read(self, device_id: int, block: Block, *, priority: bool = False) -> Exchange:
        """Read a block. Raises WireError, or the DeviceError of the exception that came."""

    async def read_words(
        self, device_id: int, table: Table, address: int, count: int, *, priority: bool = False
    ) -> Exchange:
        """Read words. Raises as ``read`` does."""

    async def write(
        self, device_id: int, address: int, words: Sequence[int], *, priority: bool = False, function: int = WRITE
    ) -> Exchange:
        """Write words, once. After a WireError the device may or may not have carried it out."""

    async def read_write(
        self, device_id: int, write_address: int, words: Sequence[int], read_address: int, count: int
    ) -> Exchange:
        """Write, then read, in one transaction."""


class Gauge(Protocol):
    """A gauge that is asked for one position at a time (``drivers.serial_gauge``)."""

    @property
    def address(self) -> GaugeAddress:
        """Where it is."""

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""

    async def open(self) -> None:
        """Open the line. Raises ConnectionLostError."""

    async def close(self) -> None:
        """Close the line."""

    async def read(self, *, priority: bool = False) -> Reading:
        """Ask once. Raises WireError."""


Bus: TypeAlias = Modbus | Gauge


def is_gauge(bus: Bus) -> TypeIs[Gauge]:
    """Whether a bus is a gauge's line."""
    return isinstance(bus.address, GaugeAddress)


class UnopenedBus(Generic[_Address]):
    """A bus by its address alone: what is wired to it can be judged, and nothing can be sent."""

    lost_answer_s = 0.0
    writes = 0

    def __init__(self, address: _Address) -> None:
        self.address = address

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""
        return self.address.name

    async def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise ConnectionLostError(say("bus_closed", "bus {bus}: it is closed, open it first", bus=self.name))

    open = read = read_words = write = read_write = _refuse

    async def close(self) -> None:
        """It is closed."""

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Nothing has to be proven of it."""


def unopened(address: BusAddress) -> Bus:
    """Return a bus by its address alone."""
    if isinstance(address, GaugeAddress):
        return UnopenedBus[GaugeAddress](address)
    return UnopenedBus[ModbusAddress](address)
