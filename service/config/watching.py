"""``[valves.watch]`` in plant.toml: each by itself, and whether a bus has the time for all of its valves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import time
from typing import TYPE_CHECKING, Annotated, Final
from zoneinfo import ZoneInfo

from pydantic import BaseModel, ConfigDict, Field

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress, ValveWiring
from drivers.registers import Block
from drivers.sampler import Sampler
from drivers.watch_rules import LONGEST_PERIOD_S, SHORTEST_PERIOD_S, WatchRules
from service.config.errors import Findings, Key
from valve.errors import ConfigurationError
from valve.messages import say

if TYPE_CHECKING:
    from drivers.wiring import Wired

_CLOCK: Final = r"^([01][0-9]|2[0-3]):[0-5][0-9]$"
#: Of a bus's time: the rest is for answers that come late, and for asking again.
_MOST_SHARE: Final = 0.7
_NETWORK_READ_S: Final = 2.0e-3  # a PLC's answer on a local network; the service itself needs a tenth of it
_GAUGE_READ_S: Final = 0.05
_CHARACTER_BITS: Final = 11
_SLAVE_S: Final = 5.0e-3  # that a slave on a serial line thinks, with the gaps round both frames


class WatchSection(BaseModel):
    """``[valves.watch]``."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    period_s: Annotated[float, Field(ge=SHORTEST_PERIOD_S, le=LONGEST_PERIOD_S)] = 0.1
    begins: Annotated[str | None, Field(alias="from", pattern=_CLOCK)] = None
    ends: Annotated[str | None, Field(alias="until", pattern=_CLOCK)] = None
    keep_days: Annotated[int, Field(ge=1, le=365)] = 7


def watch_rules(findings: Findings, given: object, key: Key) -> WatchRules | None:
    """Return how a valve is watched; None where it is not, or where that is wrong, which is noted."""
    if not isinstance(given, dict):
        return None  # told with the whole
    section = findings.model(WatchSection, given, key)
    if section is None:
        return None
    try:
        return WatchRules(section.period_s, _clock(section.begins), _clock(section.ends), section.keep_days)
    except ConfigurationError as error:
        findings.add_error(key, error)
        return None


def _clock(given: str | None) -> time | None:
    return None if given is None else time.fromisoformat(given)


def by_clock_of(wiring: ValveWiring, zone: ZoneInfo | None) -> ValveWiring:
    """Return a wiring whose valve is watched by the clock of the plant's zone."""
    return wiring if wiring.watch is None else replace(wiring, watch=replace(wiring.watch, zone=zone))


def check_watching(
    findings: Findings,
    valves: Sequence[tuple[Key, ValveWiring | None]],
    wired: Mapping[str, Wired],
    buses: Mapping[int, BusAddress | None],
) -> None:
    """Note every bus that is asked for more reads than it has time for, at the valve that asks for most.

    ``valves`` have their keys in the file beside them.
    """
    addresses: dict[str, BusAddress] = {one.name: one for one in buses.values() if one is not None}
    shares: defaultdict[str, dict[str, float]] = defaultdict(dict)
    watched = {
        wiring.tag: (key, wiring.watch) for key, wiring in valves if wiring is not None and wiring.watch is not None
    }
    for tag, (_, rules) in watched.items():
        if tag not in wired:
            continue  # what is wrong with it is told
        for bus, read_s in _reads_s(tag, wired[tag], addresses).items():
            shares[bus][tag] = read_s / rules.period_s
    for bus, of_valves in shares.items():
        asked = sum(of_valves.values())
        if asked <= _MOST_SHARE:
            continue
        key, rules = watched[max(of_valves, key=of_valves.__getitem__)]
        enough_s = rules.period_s * asked / _MOST_SHARE
        findings.add(
            (*key, "watch", "period_s"),
            rules.period_s,
            say(
                "bus_time_of_watched",
                "the {count} valves watched on bus {bus} need {asked:.0f %} of its time, {most_share:.0f %} can be had",
                count=len(of_valves),
                bus=bus,
                asked=asked,
                most_share=_MOST_SHARE,
            ),
            say(
                "read_more_rarely",
                "read each of them every {period:g} s or more rarely, or watch fewer at a time",
                period=_rounded_up(enough_s),
            ),
        )


def _rounded_up(seconds: float) -> float:
    steps = (0.02, 0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, LONGEST_PERIOD_S)
    return next((one for one in steps if one >= seconds), seconds)


def _reads_s(tag: str, wired: Wired, addresses: Mapping[str, BusAddress]) -> dict[str, float]:
    """Return how long one sample takes of each bus, s."""
    taken: defaultdict[str, float] = defaultdict(float)
    for bus, block in Sampler(tag, wired).reads:
        if bus in addresses:
            taken[bus] += _read_s(addresses[bus], block)
    return taken


def _read_s(address: BusAddress, block: Block | None) -> float:
    if block is None or isinstance(address, GaugeAddress):
        return _GAUGE_READ_S
    if isinstance(address, RtuAddress):
        return (8 + 5 + 2 * block.words) * _CHARACTER_BITS / address.baud_rate + _SLAVE_S
    return _NETWORK_READ_S
