"""Valves in service that are read from a raw device, as tests ask it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.addresses import BusAddress, ValveWiring
from drivers.motion.bus_lock import watch_name
from drivers.motion.watch_post import ask_to_leave
from drivers.motion.watching import Watching
from drivers.stands_at import RestRules
from drivers.watch_rules import WatchRules
from tests.support.played_device import WIRING
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import RawSlave

READS = {1, 2, 3, 4}
RULES = WatchRules(0.02)
WATCHED = replace(WIRING, rest=RestRules(after_s=0.0, travel_m=0.1), watch=RULES)


@dataclass
class Plant:
    wirings: dict[str, ValveWiring]

    @property
    def buses(self) -> dict[str, BusAddress]:
        """Nobody compares them here."""
        return {}

    def read(self) -> None:
        """Nothing is read."""

    def take(self, fresh: None, kept: frozenset[str]) -> None:
        """It is taken over already."""

    def settle(self, tag: str) -> None:
        """It is settled already."""


async def until(condition: Callable[[], bool], what: str, within_s: float = 20.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"{what} did not happen within {within_s:g} s"
        await asyncio.sleep(0.005)


@asynccontextmanager
async def meanwhile(work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Let something go on for the length of a block."""
    going = asyncio.create_task(work)
    try:
        yield
    finally:
        going.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await going


@asynccontextmanager
async def watching(
    folder: Path,
    address: BusAddress,
    *wirings: ValveWiring,
    plant: Plant | None = None,
    beside: BusAddress | None = None,
    after_s: float = 0.0,
) -> AsyncIterator[Watching]:
    plant = plant or Plant({one.tag: one for one in wirings or (WATCHED,)})
    addresses = {one.name: one for one in (address, beside) if one is not None}
    watch = Watching(plant, addresses, folder, "breakaway 0", after_s=lambda: after_s)
    async with meanwhile(watch.run()):
        yield watch


def functions(slave: RawSlave) -> set[int]:
    return {request[1] for request in slave.requests}


def swinging(device: ReferenceDevice) -> None:
    """Let a controller move the valve: its pressure goes to and fro once a second."""
    began_s = time.monotonic()
    device.position_m = lambda _: 0.05 + 0.02 * float(np.sin(2.0 * np.pi * (time.monotonic() - began_s)))


def is_watched(address: BusAddress) -> bool:
    asked = ask_to_leave(watch_name(address), 0.01)
    if asked is not None:
        asked.close()
    return asked is not None
