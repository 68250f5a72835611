"""What happened lately, by time: a rule that counts in a row is reset by whatever comes between, this one is not."""

from __future__ import annotations

from collections import deque
from typing import Final

WINDOW_S: Final = 1.0  # within which a rule counts
_PERIODS: Final = 5.0  # and so many periods of a slow test: three bad looks with others between them


def window_s(period_s: float) -> float:
    """Return within which time the rules count what they see, s, where a look is taken every ``period_s``."""
    return max(WINDOW_S, _PERIODS * period_s)


class Recent:
    """Counts events: ``count`` of them within ``within_s`` are enough."""

    def __init__(self, count: int, within_s: float) -> None:
        self._within_s = within_s
        self._times_s: deque[float] = deque(maxlen=count)

    def note(self, now_s: float) -> bool:
        """Note an event; return whether it is enough with those before."""
        times_s = self._times_s
        times_s.append(now_s)
        return len(times_s) == times_s.maxlen and now_s - times_s[0] <= self._within_s


class RecentLooks:
    """Counts looks that failed among all: half of them within ``within_s``, and so many at least, are enough."""

    def __init__(self, least: int, within_s: float) -> None:
        self._least = least
        self._within_s = within_s
        self._looks: deque[tuple[float, bool]] = deque()
        self._failed = 0

    def note(self, now_s: float, *, failed: bool) -> None:
        """Note a look."""
        self._looks.append((now_s, failed))
        self._failed += failed
        while now_s - self._looks[0][0] > self._within_s:
            self._failed -= self._looks.popleft()[1]

    @property
    def too_many_failed(self) -> bool:
        """Whether they are enough by now."""
        return self._failed >= self._least and 2 * self._failed >= len(self._looks)
