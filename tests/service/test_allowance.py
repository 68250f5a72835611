"""How long a worker may take: its own processor time counts, not what others do on the machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from service.workers.allowance import Allowance, processor_time_s


def test_waiting_uses_none_of_it() -> None:
    own = Allowance(os.getpid(), 0.2)
    time.sleep(0.3)  # longer than the whole allowance, as beside other work
    assert own.left_s() > 0.0


def test_work_uses_it_up() -> None:
    own = Allowance(os.getpid(), 0.05)
    until_s = time.process_time() + 0.1
    while time.process_time() < until_s:
        pass
    assert own.left_s() <= 0.0


def test_a_process_that_sleeps_for_ever_has_taken_too_long_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Allowance(os.getpid(), 1.0)
    now_s = time.monotonic()
    monkeypatch.setattr("service.workers.allowance.time.monotonic", lambda: now_s + 60.0)
    assert own.left_s() <= 0.0


def test_the_clock_counts_where_the_system_does_not_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.workers.allowance.processor_time_s", lambda _pid: None)
    own = Allowance(os.getpid(), 1.0)
    now_s = time.monotonic()
    assert own.left_s() > 0.0
    monkeypatch.setattr("service.workers.allowance.time.monotonic", lambda: now_s + 1.1)
    assert own.left_s() <= 0.0


def test_a_process_that_has_ended_has_no_processor_time() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    assert processor_time_s(ended.pid) is None
