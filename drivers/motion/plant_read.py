"""What a process has read of plant.toml, in a few digits: whether two processes would move a valve alike."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import lru_cache
from pathlib import PurePath
from typing import Any, Final

from drivers.addresses import BusAddress, ValveWiring
from drivers.permissive import Permissive
from valve.messages import say

#: The permissive that says whether service and motion process have read the same of a valve.
SAME_PLANT: Final = "plant_file"
_DIGITS: Final = 16  # of SHA-256 in hex: two that differ are alike once in 2 ** 64
_CACHED: Final = 16_384  # valves: more are hashed anew each time


@dataclass(frozen=True, slots=True)
class PlantRead:
    """Fingerprints by name: ``valves`` of wiring, limits and the addresses of their buses, ``buses`` of these alone."""

    valves: Mapping[str, str]
    buses: Mapping[str, str]

    @property
    def digest(self) -> str:
        """All of it in one; equal where nothing differs."""
        return _hashed([sorted(self.valves.items()), sorted(self.buses.items())])

    def differing(self, other: PlantRead) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the valves, and the buses, that the two do not have alike; one that only one of them has is none."""
        return _unlike(self.valves, other.valves), _unlike(self.buses, other.buses)


def _unlike(ours: Mapping[str, str], theirs: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(sorted(name for name in {*ours, *theirs} if ours.get(name) != theirs.get(name)))


def plant_read(wirings: Iterable[ValveWiring], buses: Mapping[str, BusAddress]) -> PlantRead:
    """Return the fingerprints of valves and of the buses that they use."""
    known = tuple(wirings)
    used = sorted({bus for wiring in known for bus in wiring.buses})
    return PlantRead(
        {wiring.tag: valve_read(wiring, buses) for wiring in known},
        {name: _hashed(_plain(buses.get(name))) for name in used},
    )


def valve_read(wiring: ValveWiring, buses: Mapping[str, BusAddress]) -> str:
    """Return the fingerprint of one valve: all that decides how it is moved, how far, and by which device."""
    return _valve_read(wiring, tuple(buses.get(name) for name in sorted(wiring.buses)))


@lru_cache(_CACHED)
def _valve_read(wiring: ValveWiring, addresses: tuple[BusAddress | None, ...]) -> str:
    points = (wiring.command, wiring.position, wiring.pressure, *wiring.permissives.points)
    used = {point.map for point in points if point is not None}
    said = {one.name: getattr(wiring, one.name) for one in fields(wiring) if one.name != "maps"}
    said["maps"] = {name: one for name, one in wiring.maps.items() if name in used}
    return _hashed(_plain([said, addresses]))


def same_plant(tag: str, ours: str, theirs: str) -> Permissive:
    """Return the permissive that both have read the same of a valve: the tablet shows by what it would be moved."""
    is_same = ours == theirs
    return Permissive(
        SAME_PLANT,
        is_same,
        say("plant_read_alike", "the same for service and motion process")
        if is_same
        else say("plant_read_differently", "service and motion process have read different ones"),
        say("one_plant_file", "one plant.toml for the wiring and the limits of {tag}", tag=tag),
        say(
            "reload_or_restart",
            "breakaway reload; if that does not do, restart service and motion process while no valve moves",
        ),
    )


def _hashed(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:_DIGITS]


def _plain(value: Any) -> Any:
    """Return a value as JSON has it, the same in every process. Raises TypeError for one that JSON cannot tell."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__name__, {one.name: _plain(getattr(value, one.name)) for one in fields(value)}]
    if isinstance(value, Mapping):
        return {str(_plain(key)): _plain(one) for key, one in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(_plain(one) for one in value)
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, bytes):
        return value.hex()
    raise TypeError(f"{type(value).__name__} has no fingerprint: give it one here")
