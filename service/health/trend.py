"""A figure's trend over the tests of a valve: a line through figures that wander, and when it meets a limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache
from typing import Final

import numpy as np

from estimators.base import student_95
from valve.stem import FloatArray

LEAST_TESTS: Final = 6  # below that the interval of a slope says little
MOST_TESTS: Final = 60  # fewer miss slow wear, more see a wear that quickens too late: `make bench ARGS=trends`
LEAST_DAYS: Final = 3.0
_MOST_DAYS: Final = 3650.0
_MOST_DAYS_OF_INTERVAL: Final = 1826.0
_DAY_S: Final = 86400.0
_FARTHEST: Final = 3  # tests apart: friction wanders over some nights, a change that stays is in six of these pairs
_LEAST_TO_SCATTER: Final = 8  # so that those six are less than half of the pairs
_OF_MEDIAN: Final = 1.4826  # standard deviation over median size, of a normal distribution
_ODD: Final = 4.0  # standard deviations from the line: what is further counts as if it were there
_EXACT: Final = 1.0e-9  # of the figure: nothing is measured better
# Days over which a wander is forgotten (0: at once), and the share of its variance that is new in each test.
_WANDERS: Final = ((0.0, 1.0), (2.0, 0.1), (2.0, 0.5), (5.0, 0.1), (5.0, 0.5), (15.0, 0.1), (15.0, 0.5))


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

    ``days`` are those of the tests, shape (n,), ``values`` the figures, shape (n, n_figures). A figure is a line, what
    is new in each test, and a wander that is forgotten exponentially. Nobody knows over how many days: the lines by
    generalised least squares are averaged over ``_WANDERS`` by their restricted likelihood (Harville 1977). Tests
    far from the line by Theil (1950) and Sen (1968) are drawn nearer first.
    """
    near = _without_odd(days, values)
    least = np.square(_EXACT * np.max(np.abs(values), axis=0))
    count = days.size
    likelihoods, lines, covariances = [], [], []
    for whitening, base, inverse, log_size in _laws(tuple(days.tolist())):
        white = whitening @ near
        explained = base.T @ white
        rest = np.maximum(np.sum(np.square(white), axis=0) - np.sum(np.square(explained), axis=0), least)
        likelihoods.append(-log_size - 0.5 * (count - 2) * np.log(np.maximum(rest, np.finfo(float).tiny)))
        lines.append(inverse @ explained)
        covariances.append((inverse @ inverse.T)[:, :, None] * (rest / (count - 2)))
    weights = np.exp(np.array(likelihoods) - np.max(likelihoods, axis=0))
    weights /= np.sum(weights, axis=0)
    line = np.einsum("mf,mcf->cf", weights, np.array(lines))
    apart = np.array(lines) - line
    spread = np.array(covariances) + apart[:, :, None] * apart[:, None, :]
    whole = np.einsum("mf,mcdf->cdf", weights, spread)
    covariance = (whole[0, 0], whole[0, 1], whole[1, 1])
    return Lines(line[0], line[1], covariance, student_95(count - 2))


@lru_cache(maxsize=8)  # the figures of one result are of the same tests, but for a few
def _laws(days: tuple[float, ...]) -> list[tuple[FloatArray, FloatArray, FloatArray, float]]:
    """Return for each law of wander what whitens tests of these days, and the line's QR factors.

    That is: inverse Cholesky factor of the correlation, Q, inverse of R, and the logarithm of what scales the
    restricted likelihood.
    """
    at = np.array(days)
    line = np.column_stack((np.ones(at.size), at))
    apart = np.abs(at[:, None] - at)
    laws = []
    for forgotten_days, share in _WANDERS:
        correlation = share * np.eye(at.size)
        if forgotten_days > 0.0:
            correlation += (1.0 - share) * np.exp(-apart / forgotten_days)
        factor = np.linalg.cholesky(correlation)
        whitening = np.linalg.inv(factor)
        base, upper = np.linalg.qr(whitening @ line)
        log_size = float(np.sum(np.log(np.diag(factor))) + np.sum(np.log(np.abs(np.diag(upper)))))
        laws.append((whitening, base, np.linalg.inv(upper), log_size))
    return laws


def _without_odd(days: FloatArray, values: FloatArray) -> FloatArray:
    """Return the values with those far from the robust line at ``_ODD`` standard deviations from it."""
    first, second = np.triu_indices(days.size, 1)
    apart = days[second] - days[first]
    pairs = apart > 0.0
    slopes = np.median((values[second] - values[first])[pairs] / apart[pairs, None], axis=0)
    rest = values - slopes * days[:, None]
    middle = np.median(rest, axis=0)
    rest -= middle
    most = _ODD * _OF_MEDIAN * np.median(np.abs(rest), axis=0)
    return np.asarray(middle + slopes * days[:, None] + np.clip(rest, -most, most), dtype=np.float64)
