"""One signal of a valve on the wire, by its place and by what it means."""

from __future__ import annotations

from dataclasses import dataclass

from valve.errors import ConfigurationError, refuse


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
        faults = []
        if self.device_id is not None and not 0 <= self.device_id <= 255:  # which of them a bus has, its kind says
            faults.append(f"bus {self.bus}: device_id {self.device_id} is outside 0 to 255, correct it")
        if (self.device_id is None) != (self.map is None):
            faults.append(f"bus {self.bus}: device_id and map belong together, give both or (gauge) none")
        if (self.signal is None) != (self.quantity is None):
            faults.append(f"bus {self.bus}: signal and quantity belong together, give both or none")
        for name, ends in (("signal", self.signal), ("quantity", self.quantity)):
            if ends is not None and ends[0] == ends[1]:
                faults.append(f"bus {self.bus}: {name} is {ends[0]:g} to {ends[1]:g}, its ends must differ: correct it")
        refuse(ConfigurationError, faults)
