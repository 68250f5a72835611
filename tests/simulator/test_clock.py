from __future__ import annotations

import time

import pytest

from simulator.clock import ManualClock, RunningClock
from valve.errors import ParameterError


def test_a_clock_of_speed_50_runs_50_times_faster() -> None:
    clock = RunningClock(50.0)
    first, real = clock.now_s(), time.monotonic()
    while time.monotonic() < real + 0.02:
        pass
    before = time.monotonic()
    passed = clock.now_s() - first
    after = time.monotonic()
    assert 50.0 * (before - real) * 0.9 <= passed <= 50.0 * (after - real) + 50.0 * 0.01


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_clock_that_does_not_run_is_refused(speed: float) -> None:
    with pytest.raises(ParameterError, match="speed"):
        RunningClock(speed)


def test_a_manual_clock_moves_only_forward() -> None:
    clock = ManualClock(2.0)
    clock.advance(0.5)
    assert clock.now_s() == 2.5
    with pytest.raises(ParameterError, match="backwards"):
        clock.advance(-0.1)
