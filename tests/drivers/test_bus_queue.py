"""The turns on a bus: one at a time, a stop before all others, and none is lost by a cancellation wherever it comes."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from drivers.bus_queue import BusQueue

STEPS = 24  # of the event loop; all is over after fewer


class Users:
    """Who used the queue, in order, and whether two ever did at once."""

    def __init__(self) -> None:
        self.queue = BusQueue()
        self.order: list[str] = []
        self.inside = 0

    async def use(self, name: str, *, priority: bool = False) -> None:
        async with self.queue.hold(priority=priority):
            self.inside += 1
            assert self.inside == 1, "two at once"
            self.order.append(name)
            try:
                await asyncio.sleep(0)
                await asyncio.sleep(0)
            finally:
                self.inside -= 1


def _tasks(users: Users) -> dict[str, asyncio.Task[None]]:
    made = {name: asyncio.create_task(users.use(name)) for name in ("first", "second", "third")}
    made["stop"] = asyncio.create_task(users.use("stop", priority=True))
    made["fourth"] = asyncio.create_task(users.use("fourth"))
    return made


def cases() -> Iterator[tuple[tuple[str, ...], int]]:
    for cancelled in (("first",), ("second",), ("stop",), ("second", "stop"), ("first", "third"), ("third", "fourth")):
        for step in range(STEPS):
            yield cancelled, step


@pytest.mark.parametrize(("cancelled", "step"), list(cases()))
async def test_a_cancellation_at_any_await_ends_that_caller_alone(cancelled: tuple[str, ...], step: int) -> None:
    users = Users()
    tasks = _tasks(users)
    for _ in range(step):
        await asyncio.sleep(0)
    for name in cancelled:
        tasks[name].cancel()
    async with asyncio.timeout(5.0):
        ends = dict(zip(tasks, await asyncio.gather(*tasks.values(), return_exceptions=True), strict=True))
    for name, end in ends.items():
        assert end is None or (name in cancelled and isinstance(end, asyncio.CancelledError)), (name, end)
    for name in tasks.keys() - cancelled:
        assert name in users.order
    async with asyncio.timeout(5.0):
        await users.use("after")


@pytest.mark.parametrize("step", range(STEPS))
async def test_a_cancellation_in_the_same_instant_as_the_turn_passes_it_on(step: int) -> None:
    users = Users()
    async with users.queue.hold():
        waiting = [asyncio.create_task(users.use(name)) for name in ("one", "two", "three")]
        for _ in range(4):
            await asyncio.sleep(0)
        waiting[0].cancel()  # its turn comes before it hears of it
    for _ in range(step):
        await asyncio.sleep(0)
    waiting[1].cancel()
    async with asyncio.timeout(5.0):
        ends = await asyncio.gather(*waiting, return_exceptions=True)
    assert isinstance(ends[0], asyncio.CancelledError)
    assert ends[1] is None or isinstance(ends[1], asyncio.CancelledError)
    assert ends[2] is None
    assert users.order[-1] == "three"


@pytest.mark.parametrize("late", range(6))
async def test_a_stop_comes_next_whenever_it_is_asked_for(late: int) -> None:
    users = Users()
    waiting = [asyncio.create_task(users.use(str(number))) for number in range(5)]
    for _ in range(late):
        await asyncio.sleep(0)
    begun = len(users.order)
    stops = [asyncio.create_task(users.use(f"stop {number}", priority=True)) for number in range(2)]
    async with asyncio.timeout(5.0):
        await asyncio.gather(*waiting, *stops)
    ordinary = [name for name in users.order if not name.startswith("stop")]
    assert ordinary == sorted(ordinary)
    assert users.order.index("stop 0") <= begun + 1, "at most one transaction was under way"
    assert users.order.index("stop 1") == users.order.index("stop 0") + 1
