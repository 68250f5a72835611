"""A watchdog is armed only where it shows what was written to it: the timeout and the value that it would drive."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.capabilities import Watchdog
from drivers.device_watchdog import DeviceWatchdog
from drivers.maps import register_map
from drivers.wiring import Unit
from valve.errors import DeviceError

REFERENCE = register_map("reference")
TIMEOUT_S, SAFE_PA, TOLERANCE_PA, RUN = 2.0, 5_000.0, 100.0, 7


class Shown:
    """A unit that takes every write and then shows ``shown`` in its place."""

    def __init__(self, **shown: float) -> None:
        self.map = REFERENCE
        self.subject = "bus plc: device 1"
        self.written: dict[str, float] = {}
        self._shown = shown

    async def value(self, name: str) -> float:
        return (await self.values(name))[name]

    async def values(self, *names: str) -> dict[str, float]:
        known = {watchdog().state: float(watchdog().armed), watchdog().heartbeat: 0.0, **self.written, **self._shown}
        return {name: known[name] for name in names}

    async def write(self, values: dict[str, float]) -> SimpleNamespace:
        self.written |= values
        return SimpleNamespace(sent_s=12.0)


def watchdog() -> Watchdog:
    assert REFERENCE.watchdog is not None
    return REFERENCE.watchdog


async def armed(**shown: float) -> DeviceWatchdog:
    timer = DeviceWatchdog("FV-101", cast("Unit", cast("Any", Shown(**shown))), TIMEOUT_S, TOLERANCE_PA)
    await timer.arm(RUN, SAFE_PA)
    return timer


async def test_what_it_shows_within_the_steps_of_its_registers_is_armed() -> None:
    assert (await armed()).fed_s == 12.0
    step_s = REFERENCE.register(watchdog().timeout).resolution
    await armed(**{watchdog().timeout: TIMEOUT_S + step_s, watchdog().safe_value: SAFE_PA + TOLERANCE_PA})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (watchdog().timeout, TIMEOUT_S + 3.0 * REFERENCE.register(watchdog().timeout).resolution + 1.0e-3),
        (watchdog().timeout, 0.0),
        (watchdog().safe_value, SAFE_PA + 1.01 * TOLERANCE_PA),
        (watchdog().safe_value, SAFE_PA - 1.01 * TOLERANCE_PA),
        (watchdog().safe_value, math.nan),
        (watchdog().state, float(watchdog().tripped)),
    ],
)
async def test_another_timeout_safe_value_or_state_than_was_written_is_no_watchdog(name: str, value: float) -> None:
    with pytest.raises(DeviceError, match="not armed with them"):
        await armed(**{name: value})
