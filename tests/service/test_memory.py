"""When the garbage collector makes its full rounds: not while a valve is polled."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Iterator

import pytest

from service.server.server import settle_memory, tidy_at_rest
from service.workers.polling import Polling


@pytest.fixture
def own_collector() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)
    gc.unfreeze()


@pytest.mark.usefixtures("own_collector")
def test_a_service_that_has_started_makes_full_rounds_seldom_and_over_little() -> None:
    before = gc.get_threshold()
    settle_memory()
    assert gc.get_freeze_count() > 10_000
    assert gc.get_threshold()[2] >= 10 * before[2]


async def test_full_rounds_are_made_when_the_last_polled_valve_is_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(gc, "collect", lambda: made.append("round"))
    polling = Polling()
    tidying = asyncio.create_task(tidy_at_rest(polling))
    await asyncio.sleep(0)
    with polling.motion():
        with polling.motion():
            polling.tell()
            await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert made == []
    await asyncio.sleep(0)
    assert made == ["round"]
    tidying.cancel()
    await asyncio.gather(tidying, return_exceptions=True)
