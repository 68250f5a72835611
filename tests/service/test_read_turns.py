from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from service.access.principal import Role
from service.http import read_turns
from service.http.read_turns import AT_ONCE, ReadTurns
from service.store.run_table import RunTable
from tests.service.access.signed_in import signed_in

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


async def test_nobody_waits_for_a_turn_to_be_told_that_they_are_unknown(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(read_turns, "_LONGEST_TURN_S", 60.0)
    go_on, begun, newest = threading.Event(), threading.Semaphore(0), RunTable.newest

    def slow(*args: Any, **more: Any) -> Any:
        begun.release()
        go_on.wait()
        return newest(*args, **more)

    monkeypatch.setattr(RunTable, "newest", slow)
    async with signed_in(quick_path) as served:
        viewer = served.tokens[Role.VIEWER]
        reads = [asyncio.create_task(served.client.get("/tests", headers=viewer)) for _ in range(AT_ONCE)]
        try:
            for _ in reads:
                await asyncio.to_thread(begun.acquire)
            async with asyncio.timeout(10.0):
                assert (await served.client.get("/tests")).status_code == 401
        finally:
            go_on.set()
        assert [answer.status_code for answer in await asyncio.gather(*reads)] == [200] * AT_ONCE
