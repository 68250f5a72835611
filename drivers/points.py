"""One signal of a valve on the wire, by its place and by what it means."""

from __future__ import annotations

from dataclasses import dataclass

from valve.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Point:
    """One signal of a valve: a register of a device on a bus, or a gauge (then ``bus`` alone).

    ``register`` defaults to the map's own for the role. ``signal`` (in the register's unit) stands for ``quantity``
    (Pa or m); both may be left out where the register is in Pa or m already. ``readback_register`` is where the
    device shows what it really asks of its output.
    """

    bus: str
    device_id: int | None = None
    map: str | None = None
    register: str | None = None
    signal: tuple[float, float] | None = None
    quantity: tuple[float, float] | None = None
    readback_register: str | None = None

    def __post_init__(self) -> None:
        # 0 would be a broadcast: every valve on the line would move.
        if self.device_id is not None and not 1 <= self.device_id <= 247:
            raise ConfigurationError(f"bus {self.bus}: device_id {self.device_id} is outside 1 to 247, correct it")
        if (self.device_id is None) != (self.map is None):
            raise ConfigurationError(f"bus {self.bus}: device_id and map belong together, give both or (gauge) none")
        if (self.signal is None) != (self.quantity is None):
            raise ConfigurationError(f"bus {self.bus}: signal and quantity belong together, give both or none")
