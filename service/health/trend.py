"""A figure's trend over the tests of a valve: a slope that a few odd tests do not turn, and when a limit is met."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

import numpy as np

LEAST_TESTS: Final = 6  # below that the interval by ranks has no end
LEAST_DAYS: Final = 3.0
_NORMAL_95: Final = 1.959964
_MOST_DAYS: Final = 3650.0
_DAY_S: Final = 86400.0
_FARTHEST: Final = 3  # tests apart: friction wanders over some nights, a change that stays is in six of these pairs
_LEAST_TO_SCATTER: Final = 8  # so that those six are less than half of the pairs
_OF_MEDIAN: Final = 1.4826  # standard deviation over median size, of a normal distribution


@dataclass(frozen=True, slots=True)
class Slope:
    """Change a day with its 95 % interval, and the level that the line has at its last test."""

    per_day: float
    ci95: tuple[float, float]
    last: float
    last_at: datetime

    @property
    def is_sure(self) -> bool:
        """Whether the interval leaves zero out."""
        return not self.ci95[0] <= 0.0 <= self.ci95[1]

    def reaches(self, level: float) -> datetime | None:
        """Return when the line meets a level; None where it does not run there within ten years."""
        if not self.is_sure or self.per_day == 0.0:
            return None
        days = (level - self.last) / self.per_day
        return self.last_at + timedelta(days=days) if 0.0 <= days <= _MOST_DAYS else None


def scatter_between(values: Sequence[float]) -> float:
    """How much a figure differs from test to test, as a standard deviation in its unit; 0 for too few tests.

    1.4826 times the median size of the differences of tests up to three apart, over the root of 2. Neither a slow
    drift, nor a change that stays, nor a few odd tests are in it.
    """
    if len(values) < _LEAST_TO_SCATTER:
        return 0.0
    level = np.asarray(values, dtype=np.float64)
    apart = [np.abs(level[lag:] - level[:-lag]) for lag in range(1, _FARTHEST + 1)]
    return _OF_MEDIAN * float(np.median(np.concatenate(apart))) / math.sqrt(2.0)


def robust_slope(times: Sequence[datetime], values: Sequence[float]) -> Slope | None:
    """Return the median of the slopes of all pairs, with the interval by ranks; None for too few tests or days.

    Theil (1950), Sen (1968): the interval's ends are the pairs' slopes of rank (N ± z sqrt(n (n-1) (2n+5) / 18)) / 2
    of N. Up to 29 % of the tests may be odd ones.
    """
    count = len(values)
    if count < LEAST_TESTS or len(times) != count:
        return None
    days = np.array([(at - times[-1]).total_seconds() for at in times]) / _DAY_S
    if float(days.max() - days.min()) < LEAST_DAYS:
        return None
    level = np.asarray(values, dtype=np.float64)
    first, second = np.triu_indices(count, 1)
    apart = days[second] - days[first]
    slopes = np.sort(((level[second] - level[first])[apart != 0.0]) / apart[apart != 0.0])
    reach = _NORMAL_95 * math.sqrt(count * (count - 1) * (2 * count + 5) / 18.0)
    low = max(round((slopes.size - reach) / 2.0) - 1, 0)
    high = min(round((slopes.size + reach) / 2.0), slopes.size - 1)
    middle = float(np.median(slopes))
    last = float(np.median(level - middle * days))
    return Slope(middle, (float(slopes[low]), float(slopes[high])), last, times[-1])
