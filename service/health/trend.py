"""A figure's trend over the tests of a valve: a line through figures that wander, and when it meets a limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

import numpy as np

from estimators.base import student_95
from service.health.wander import OF_MEDIAN, fitted
from valve.stem import FloatArray

LEAST_TESTS: Final = 6  # below that the interval of a slope says little
MOST_TESTS: Final = 60  # fewer miss slow wear, more see a wear that quickens too late: `make bench ARGS=trends`
LEAST_DAYS: Final = 3.0
_MOST_DAYS: Final = 3650.0
_MOST_DAYS_OF_INTERVAL: Final = 1826.0
_DAY_S: Final = 86400.0
_ODD: Final = 4.0  # standard deviations from the line: what is further counts as if it were there


@dataclass(frozen=True, slots=True)
class Crossing:
    """When a line meets a level, with its 95 % interval; None: not within five years."""

    at: datetime
    earliest: datetime | None
    latest: datetime | None


@dataclass(frozen=True, slots=True)
class Slope:
    """Change a day with its 95 % interval, and the level that the line has at its last test.

    ``covariance`` is that of level and change a day: both variances with that of both between them, each times the
    square of the quantile that 95 % need.
    """

    per_day: float
    ci95: tuple[float, float]
    last: float
    last_at: datetime
    tests: int
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def is_sure(self) -> bool:
        """Whether the interval leaves zero out."""
        return not self.ci95[0] <= 0.0 <= self.ci95[1]

    def reaches(self, level: float) -> Crossing | None:
        """Return when the line meets a level, at its last test if it is beyond; None if not within ten years.

        The interval has the instants at which the level is in the 95 % band of the line (Fieller 1954).
        """
        if not self.is_sure:
            return None
        way = level - self.last
        days = max(way / self.per_day, 0.0)
        if days > _MOST_DAYS:
            return None
        of_level, of_both, of_slope = self.covariance
        # (way - b h)^2 = v_a + 2 h v_ab + h^2 v_b: one root for each border of the band, as the slope is sure
        square = self.per_day**2 - of_slope
        middle = (way * self.per_day + of_both) / square
        half = math.sqrt(max(middle**2 - (way**2 - of_level) / square, 0.0))
        return Crossing(self._after(days), self._within(middle - half), self._within(middle + half))

    def _within(self, days: float) -> datetime | None:
        return self._after(max(days, 0.0)) if days <= _MOST_DAYS_OF_INTERVAL else None

    def _after(self, days: float) -> datetime:
        return self.last_at + timedelta(days=days)


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines through several figures at the same tests, shape (n_figures,): level now, change a day, their covariance.

    ``quantile`` times a standard deviation is half of a 95 % interval.
    """

    level: FloatArray
    per_day: FloatArray
    covariance: tuple[FloatArray, FloatArray, FloatArray]
    quantile: float


def slope_of(times: Sequence[datetime], values: Sequence[float]) -> Slope | None:
    """Return the line through the newest tests, times ascending; None for too few tests or days."""
    if len(times) != len(values) or len(values) < LEAST_TESTS:
        return None
    newest = times[-MOST_TESTS:]
    days = np.array([(at - newest[-1]).total_seconds() for at in newest]) / _DAY_S
    if float(np.ptp(days)) < LEAST_DAYS:
        return None
    found = lines_through(days, np.asarray(values[-MOST_TESTS:], dtype=np.float64)[:, None])
    of_level, of_both, of_slope = (found.quantile**2 * float(one[0]) for one in found.covariance)
    per_day, half = float(found.per_day[0]), math.sqrt(of_slope)
    covariance = (of_level, of_both, of_slope)
    return Slope(per_day, (per_day - half, per_day + half), float(found.level[0]), newest[-1], len(newest), covariance)


def lines_through(days: FloatArray, values: FloatArray) -> Lines:
    """Return the lines through figures that wander from test to test.

    ``days`` are those of the tests, shape (n,), ``values`` the figures, shape (n, n_figures), each in its unit. A
    figure is a line, what is new in each test, and a wander that is forgotten exponentially. Tests far from the line by
    Theil (1950) and Sen (1968) are drawn nearer first.
    """
    found = fitted(days, days, _without_odd(days, values))
    covariance = (found.covariance[0, 0], found.covariance[0, 1], found.covariance[1, 1])
    return Lines(found.constant, found.coefficient, covariance, student_95(found.freedom))


def _without_odd(days: FloatArray, values: FloatArray) -> FloatArray:
    """Return the values with those far from the robust line at ``_ODD`` standard deviations from it."""
    first, second = np.triu_indices(days.size, 1)
    apart = days[second] - days[first]
    pairs = apart > 0.0
    slopes = np.median((values[second] - values[first])[pairs] / apart[pairs, None], axis=0)
    rest = values - slopes * days[:, None]
    middle = np.median(rest, axis=0)
    rest -= middle
    most = _ODD * OF_MEDIAN * np.median(np.abs(rest), axis=0)
    return np.asarray(middle + slopes * days[:, None] + np.clip(rest, -most, most), dtype=np.float64)
