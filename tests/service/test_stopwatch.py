"""The tests' own stopwatch: waiting for others counts, waiting for a core does not."""

from __future__ import annotations

import time

import pytest

from tests.support import stopwatch
from tests.support.stopwatch import Stopwatch


def test_sleeping_and_working_count() -> None:
    watch = Stopwatch()
    time.sleep(0.1)
    until_s = time.thread_time() + 0.1
    while time.thread_time() < until_s:
        pass
    assert watch.own_s >= 0.15


def test_waiting_for_a_core_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stopwatch()
    waited_s = stopwatch._waited_for_a_core_s()
    time.sleep(0.1)
    monkeypatch.setattr(stopwatch, "_waited_for_a_core_s", lambda: waited_s + 0.1)
    assert watch.own_s < 0.1
