"""How a test waits between its steps."""

from __future__ import annotations

import asyncio
import time
from typing import Any, cast

import pytest

from drivers.mover import Mover, StopAskedError
from valve.errors import DeviceError

LOST = DeviceError("FV-101: permissive lost")


class Rules:
    """Rules that know of a lost permissive."""

    lost: DeviceError | None = None

    def permissive_lost(self) -> DeviceError | None:
        """Return it."""
        return self.lost


def mover(rules: Rules) -> tuple[Mover, asyncio.Event, asyncio.Event]:
    stop, wake = asyncio.Event(), asyncio.Event()
    return Mover(cast("Any", None), cast("Any", rules), stop, wake, 1.0e4), stop, wake


async def test_a_place_that_answers_again_does_not_shorten_the_pauses_that_follow() -> None:
    moving, _, wake = mover(Rules())
    wake.set()  # it was lost by time for a moment
    for _ in range(3):
        until_s = time.monotonic() + 0.05
        await moving.pause_until(until_s)
        assert time.monotonic() >= until_s


@pytest.mark.parametrize("what", ["a stop", "a permissive"])
async def test_a_pause_ends_at_once_for_a_stop_and_a_lost_permissive(what: str) -> None:
    rules = Rules()
    moving, stop, wake = mover(rules)
    waiting = asyncio.create_task(moving.pause_until(time.monotonic() + 30.0))
    await asyncio.sleep(0.05)
    if what == "a stop":
        stop.set()
    else:
        rules.lost = LOST
    wake.set()
    with pytest.raises(StopAskedError if what == "a stop" else DeviceError):
        await asyncio.wait_for(waiting, 1.0)
