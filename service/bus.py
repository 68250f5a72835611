"""One owner a bus: who may use which bus and which valve now."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from drivers.addresses import BusAddress, GaugeAddress
from drivers.serial_gauge import SerialGauge
from drivers.transport import Transport
from drivers.wiring import Bus
from valve.errors import BusyError


def make_bus(address: BusAddress) -> Bus:
    """Return the bus at an address; nothing is opened. Raises ConfigurationError where the address is wrong."""
    return SerialGauge(address) if isinstance(address, GaugeAddress) else Transport(address)


@dataclass(frozen=True, slots=True)
class Claim:
    """A valve and its buses, taken by one run."""

    run_id: str
    tag: str
    buses: frozenset[str]


class BusOwners:
    """Claims of this process; that no other process uses the plant is the store lock's concern."""

    def __init__(self) -> None:
        self._claims: dict[str, Claim] = {}

    def claim(self, run_id: str, tag: str, buses: Iterable[str]) -> Claim:
        """Take a valve and its buses. Raises BusyError where one of them is taken."""
        wanted = Claim(run_id, tag, frozenset(buses))
        for claim in self._claims.values():
            if claim.tag == tag:
                raise BusyError(f"{tag}: test {claim.run_id} uses this valve: wait for its end or stop it")
            shared = sorted(claim.buses & wanted.buses)
            if shared:
                raise BusyError(
                    f"{tag}: its bus {shared[0]} is used by test {claim.run_id} of {claim.tag}: "
                    "wait for its end or stop it"
                )
        self._claims[run_id] = wanted
        return wanted

    def release(self, claim: Claim) -> None:
        """Give valve and buses back; nothing happens where it was done already."""
        self._claims.pop(claim.run_id, None)

    def holder(self, tag: str) -> str | None:
        """Return the id of the run that uses this valve, if any."""
        return next((claim.run_id for claim in self._claims.values() if claim.tag == tag), None)
