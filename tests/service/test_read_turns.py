from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.types import Message, Receive, Scope, Send

from service.read_turns import AT_ONCE, ReadTurns

STARTED: Message = {"type": "http.response.start", "status": 200, "headers": []}


class Crowd:
    """An application whose requests wait until they are let go on; counts those that are under way."""

    def __init__(self) -> None:
        self.under_way = 0
        self.most = 0
        self.finished = 0
        self.go_on = asyncio.Event()
        self.answers_first = False

    async def __call__(self, _scope: Scope, _receive: Receive, send: Send) -> None:
        self.under_way += 1
        self.most = max(self.most, self.under_way)
        try:
            if self.answers_first:
                await send(STARTED)
            await self.go_on.wait()
        finally:
            self.under_way -= 1
            self.finished += 1


async def _receive() -> Message:
    return {"type": "http.disconnect"}


async def _send(_message: Message) -> None:
    return


def asked(app: ReadTurns, method: str, count: int) -> list[asyncio.Task[None]]:
    scope = {"type": "http", "method": method}
    return [asyncio.create_task(app(dict(scope), _receive, _send)) for _ in range(count)]


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not condition():  # noqa: ASYNC110  - it is looked at from outside
            await asyncio.sleep(0.001)


async def test_a_crowd_of_reads_is_answered_a_few_at_a_time_and_a_stop_waits_for_none_of_them() -> None:
    crowd = Crowd()
    app = ReadTurns(crowd)
    reads = asked(app, "GET", 2 * AT_ONCE)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert crowd.under_way == AT_ONCE
    stop = asked(app, "POST", 1)
    await until(lambda: crowd.under_way > AT_ONCE)
    crowd.go_on.set()
    await asyncio.gather(*reads, *stop)
    assert crowd.finished == 2 * AT_ONCE + 1


async def test_streams_whose_answer_has_begun_keep_nobody_waiting() -> None:
    crowd = Crowd()
    crowd.answers_first = True
    streams = asked(ReadTurns(crowd), "GET", 50)
    await until(lambda: crowd.under_way == 50)
    crowd.go_on.set()
    await asyncio.gather(*streams)


async def test_reads_that_wait_for_something_slow_give_their_turn_away() -> None:
    crowd = Crowd()
    reads = asked(ReadTurns(crowd), "GET", 2 * AT_ONCE)
    await until(lambda: crowd.under_way == 2 * AT_ONCE)
    for read in reads:
        read.cancel()
    await asyncio.gather(*reads, return_exceptions=True)
    assert crowd.finished == 2 * AT_ONCE


async def test_a_reader_who_leaves_while_waiting_takes_no_turn_along() -> None:
    crowd = Crowd()
    app = ReadTurns(crowd)
    first = asked(app, "GET", AT_ONCE)
    waiting = asked(app, "GET", 5)
    await asyncio.sleep(0)
    for one in waiting:
        one.cancel()
    crowd.go_on.set()
    await asyncio.gather(*first, *waiting, return_exceptions=True)
    crowd.go_on.clear()
    again = asked(app, "GET", AT_ONCE)
    await until(lambda: crowd.under_way == AT_ONCE)
    crowd.go_on.set()
    await asyncio.gather(*again)
