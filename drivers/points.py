"""One signal of a valve on the wire, by its place and by what it means."""

from __future__ import annotations

from dataclasses import dataclass

from valve.errors import ConfigurationError, refuse
from valve.messages import say


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
            faults.append(
                say(
                    "bus_device_id_outside",
                    "bus {bus}: device_id {device_id} is outside 0 to 255, correct it",
                    bus=self.bus,
                    device_id=self.device_id,
                )
            )
        if (self.device_id is None) != (self.map is None):
            faults.append(
                say(
                    "device_id_and_map",
                    "bus {bus}: device_id and map belong together, give both or (gauge) none",
                    bus=self.bus,
                )
            )
        if (self.signal is None) != (self.quantity is None):
            faults.append(
                say(
                    "signal_and_quantity",
                    "bus {bus}: signal and quantity belong together, give both or none",
                    bus=self.bus,
                )
            )
        for name, ends in (("signal", self.signal), ("quantity", self.quantity)):
            if ends is not None and ends[0] == ends[1]:
                faults.append(
                    say(
                        "ends_equal",
                        "bus {bus}: {name} is {low:g} to {high:g}, its ends must differ: correct it",
                        bus=self.bus,
                        name=name,
                        low=ends[0],
                        high=ends[1],
                    )
                )
        refuse(ConfigurationError, faults)
