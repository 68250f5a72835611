"""What must hold before a valve may move, as plant.toml says it. Data only; drivers.permissives reads and judges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from drivers.points import Point
from valve.errors import ConfigurationError, refuse
from valve.messages import say

_UNREAD_S: Final = (0.2, 10.0)  # less is one slow answer, and more is no interlock


@dataclass(frozen=True, slots=True)
class Contact:
    """A register of a device on a bus that says yes or no: by one ``bit``, or by being above or below a value.

    ``above`` and ``below`` are in the register's own unit (A for a 4-20 mA input, for example).
    """

    bus: str
    device_id: int
    map: str
    register: str
    bit: int | None = None
    above: float | None = None
    below: float | None = None

    def __post_init__(self) -> None:
        faults, subject = (
            [],
            say("contact_on_bus", "contact {register} on bus {bus}", register=self.register, bus=self.bus),
        )
        if not 0 <= self.device_id <= 255:
            faults.append(
                say(
                    "bus_device_id_outside",
                    "bus {bus}: device_id {device_id} is outside 0 to 255, correct it",
                    bus=self.bus,
                    device_id=self.device_id,
                )
            )
        if sum(one is not None for one in (self.bit, self.above, self.below)) != 1:
            faults.append(
                say("contact_needs_one", "{subject}: give exactly one of bit, above and below", subject=subject)
            )
        if self.bit is not None and not 0 <= self.bit <= 31:
            faults.append(
                say("contact_bit_outside", "{subject}: bit {bit} is outside 0 to 31", subject=subject, bit=self.bit)
            )
        refuse(ConfigurationError, faults)

    def says(self, value: float) -> bool | None:
        """Whether a value of the register means yes; None where it is no valid value."""
        if not math.isfinite(value):
            return None
        if self.bit is not None:
            return bool(round(value) >> self.bit & 1)
        if self.above is not None:
            return value > self.above
        return self.below is not None and value < self.below


@dataclass(frozen=True, slots=True)
class PermissiveRules:
    """``[valves.permissives]``: what must hold before the first move and as long as the test lasts.

    ``manual`` shows that the loop is in manual, ``interlock`` that an interlock is active; a map with such bits of its
    own needs neither. ``permit`` demands a permit number of whoever starts a test, which then stands for the manual
    mode too. ``position_m`` is where a stem can be at all, ``still_m`` how much it may move while it should rest,
    ``unread_s`` how long a contact or a supply elsewhere may stay unread during a test before it counts as lost.
    """

    manual: Contact | None = None
    manual_waived: str = ""
    interlock: Contact | None = None
    permit: bool = False
    device_number: int | None = None
    supply: Point | None = None
    supply_pa: tuple[float, float] | None = None
    position_m: tuple[float, float] | None = None
    still_m: float | None = None
    unread_s: float = 1.0

    def __post_init__(self) -> None:
        faults = [
            say(
                "permissive_limits_do_not_rise",
                "{key} must rise: give the lower value first",
                key=f"permissives.{name}",
            )
            for name, span in (("supply_pa", self.supply_pa), ("position_m", self.position_m))
            if span is not None and not span[0] < span[1]
        ]
        if self.still_m is not None and not (math.isfinite(self.still_m) and self.still_m > 0.0):
            faults.append(
                say(
                    "still_not_positive",
                    "{key} is {still:g m}, it must be above 0: correct it",
                    key="permissives.still_m",
                    still=self.still_m,
                )
            )
        if not _UNREAD_S[0] <= self.unread_s <= _UNREAD_S[1]:
            faults.append(
                say(
                    "unread_time_outside",
                    "{key} is {unread:g s}, it must be {least:g in s} to {most:g s}: correct it",
                    key="permissives.unread_s",
                    unread=self.unread_s,
                    least=_UNREAD_S[0],
                    most=_UNREAD_S[1],
                )
            )
        if self.manual is not None and self.manual_waived:
            faults.append(
                say("manual_and_waiver", "permissives: manual and manual_waived exclude each other, remove one")
            )
        if self.supply is not None and self.supply_pa is None:
            faults.append(
                say(
                    "supply_without_limits",
                    "permissives.supply is measured and {key} says no limits: give both",
                    key="supply_pa",
                )
            )
        refuse(ConfigurationError, faults)

    @property
    def points(self) -> tuple[Point | Contact, ...]:
        """Every place that must be read for them beside the valve's own signals."""
        return tuple(one for one in (self.manual, self.interlock, self.supply) if one is not None)
