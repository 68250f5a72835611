"""One owner a bus: who may use which bus and which valve now."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from drivers.addresses import BusAddress, GaugeAddress
from drivers.serial_gauge import SerialGauge
from drivers.transport import Transport
from drivers.wiring import Bus
from service.bus_lock import BusLocks
from valve.errors import BusyError

#: How long nightly checks leave a bus to somebody whom one of them kept waiting: time to press the button again.
COURTESY_S: Final = 60.0


def make_bus(address: BusAddress) -> Bus:
    """Return the bus at an address; nothing is opened. Raises ConfigurationError where the address is wrong."""
    return SerialGauge(address) if isinstance(address, GaugeAddress) else Transport(address)


@dataclass(frozen=True, slots=True)
class Claim:
    """A valve and its buses, taken by one run."""

    run_id: str
    tag: str
    buses: frozenset[str]
    scheduled: bool = False


class BusOwners:
    """Claims of this process, and by ``locks`` of this process among others.

    People go first: who was refused because a scheduled test used a bus finds it free afterwards, for a minute.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, locks: BusLocks | None = None) -> None:
        self._clock = clock
        self._locks = locks
        self._claims: dict[str, Claim] = {}
        self._kept_free: dict[str, float] = {}  # by bus: until when no scheduled test takes it

    def claim(self, run_id: str, tag: str, buses: Iterable[str], *, scheduled: bool = False) -> Claim:
        """Take a valve and its buses. Raises BusyError where one of them is taken, here or by another process."""
        wanted = Claim(run_id, tag, frozenset(buses), scheduled)
        user, reason = self._in_the_way(wanted)
        if reason:
            if user is not None and user.scheduled and not scheduled:
                self._kept_free |= dict.fromkeys(wanted.buses, math.inf)
                reason += f"; nightly checks leave the bus to you for {COURTESY_S:.0f} s after it"
            raise BusyError(f"{tag}: {reason}")
        if not scheduled:
            for bus in wanted.buses:
                self._kept_free.pop(bus, None)
        if self._locks is not None:
            self._locks.take(wanted.buses)
        self._claims[run_id] = wanted
        return wanted

    def why_not_scheduled(self, tag: str, buses: Iterable[str]) -> str:
        """Return why a scheduled test of a valve has to wait now; "" where it may start."""
        return self._in_the_way(Claim("", tag, frozenset(buses), scheduled=True))[1]

    def in_use(self, tag: str, buses: Iterable[str]) -> str:
        """Return which test uses a valve or one of its buses; "" where none does."""
        return self._in_the_way(Claim("", tag, frozenset(buses)))[1]

    def _in_the_way(self, wanted: Claim) -> tuple[Claim | None, str]:
        for claim in self._claims.values():
            if claim.tag == wanted.tag:
                return claim, f"test {claim.run_id} uses this valve: wait for its end or stop it"
            for bus in sorted(claim.buses & wanted.buses):
                return claim, (
                    f"its bus {bus} is used by test {claim.run_id} of {claim.tag}: wait for its end or stop it"
                )
        if wanted.scheduled:
            for bus in sorted(wanted.buses):
                if self._kept_free.get(bus, -math.inf) > self._clock():
                    return None, f"its bus {bus} is kept free for somebody who asked for it: people go first"
        return None, ""

    def release(self, claim: Claim) -> None:
        """Give valve and buses back; nothing happens where it was done already."""
        if self._claims.pop(claim.run_id, None) is None:
            return
        if self._locks is not None:
            self._locks.give_back(claim.buses)
        for bus in claim.buses & self._kept_free.keys():
            self._kept_free[bus] = self._clock() + COURTESY_S

    def holder(self, tag: str) -> str | None:
        """Return the id of the run that uses this valve, if any."""
        return next((claim.run_id for claim in self._claims.values() if claim.tag == tag), None)
