"""The simulated plant's clock."""

from __future__ import annotations

import math
import time
from typing import Protocol

from valve.errors import ParameterError
from valve.messages import say


class Clock(Protocol):
    """Simulated time, s, from 0 at the plant's start; it never runs backwards.

    ``speed`` is how many simulated seconds pass in a second of the master's.
    """

    speed: float

    def now_s(self) -> float:
        """Simulated time now, s."""
        ...


class RunningClock:
    """Simulated time that runs ``speed`` times faster than the machine's monotonic clock.

    Raises ParameterError unless ``speed`` is finite and above 0.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not (math.isfinite(speed) and speed > 0.0):
            raise ParameterError(
                say(
                    "clock_speed_not_positive",
                    "the clock's speed is {speed:g}, it must be above 0: 1 is real time",
                    speed=speed,
                )
            )
        self.speed = speed
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Simulated time now, s."""
        return (time.monotonic() - self._start_s) * self.speed


class ManualClock:
    """Simulated time that moves only when it is told to."""

    def __init__(self, start_s: float = 0.0) -> None:
        self.speed = 1.0
        self._now_s = start_s

    def now_s(self) -> float:
        """Simulated time now, s."""
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Let ``duration_s`` pass. Raises ParameterError where it is negative."""
        if not duration_s >= 0.0:
            raise ParameterError(
                say(
                    "clock_runs_backwards",
                    "the clock was to advance by {time:g s}, time does not run backwards",
                    time=duration_s,
                )
            )
        self._now_s += duration_s
