"""A change of a figure's level that stayed: the newest tests beside all before them, with the wander in the error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import numpy as np
from scipy.special import stdtrit

from estimators.base import student_95
from service.health.trend import MOST_TESTS
from service.health.wander import OF_MEDIAN, fitted
from valve.stem import FloatArray

_MOST_SINCE: Final = 8  # tests after the change: of an older one the line through the tests tells
_LEAST_SINCE: Final = 2  # one test may be odd
_LEAST_BEFORE: Final = 6
#: That a level which only wanders looks changed, whichever way: asked anew after each test, of seven instants.
_BY_CHANCE: Final = 1.0e-4
_DAY_S: Final = 86400.0
_NEAR: Final = 2.0  # standard deviations from its neighbours' median: a test before the change is drawn there


@dataclass(frozen=True, slots=True)
class Step:
    """A change of level with its 95 % interval: of the ``tests`` since an instant, beside all before."""

    before: float
    change: float
    ci95: tuple[float, float]
    since: datetime
    tests: int


@dataclass(frozen=True, slots=True)
class Steps:
    """The change of several figures, shape (n_figures,), 0 where there is none; its half interval; tests since it."""

    before: FloatArray
    change: FloatArray
    half: FloatArray
    tests: FloatArray


def steps_at(times: Sequence[datetime], values: FloatArray, least: FloatArray) -> list[Step | None]:
    """Return each figure's change of level within the newest tests, times ascending; None where it may be a wander.

    ``values``: shape (n, n_figures), and ``least``: shape (2, n_figures), in each figure's unit.
    """
    newest = times[-MOST_TESTS:]
    days = np.array([(at - newest[-1]).total_seconds() for at in newest]) / _DAY_S
    found = steps_of(days, values[-MOST_TESTS:], least)
    return [
        Step(
            float(before), float(change), (float(change - half), float(change + half)), newest[-int(tests)], int(tests)
        )
        if tests
        else None
        for before, change, half, tests in zip(found.before, found.change, found.half, found.tests, strict=True)
    ]


def steps_of(days: FloatArray, values: FloatArray, least: FloatArray) -> Steps:
    """Return the surest change of each figure, shape (n, n_figures), in its unit, that lies within the newest tests.

    ``days`` are those of the tests, shape (n,); ``least`` has the smallest rise and fall that count, shape
    (2, n_figures). No single test makes a change: of the tests since it the one that is farthest counts as the next,
    and the odd ones before it are drawn to their neighbours.
    """
    count, figures = values.shape
    found = np.zeros((4, figures))
    surest = np.ones(figures)
    quantile = float(stdtrit(max(count - 2, 1), 1.0 - _BY_CHANCE / 2.0))
    for tests in range(_LEAST_SINCE, min(_MOST_SINCE, count - _LEAST_BEFORE) + 1):
        since = np.arange(count) >= count - tests
        former = _drawn_near(values[:-tests], values)
        ordered = np.sort(values[-tests:], axis=0)
        risen = np.concatenate((former, np.minimum(values[-tests:], ordered[-2])))
        fallen = np.concatenate((former, np.maximum(values[-tests:], ordered[1])))
        fit = fitted(days, since.astype(np.float64), np.concatenate((risen, -fallen), axis=1))
        deviation = np.sqrt(fit.covariance[1, 1])
        sure = fit.coefficient / (quantile * np.maximum(deviation, np.finfo(float).tiny))
        sure = np.where(fit.coefficient >= least.ravel(), sure, 0.0)
        half = student_95(fit.freedom) * deviation
        told = np.array((fit.constant, fit.coefficient, half, np.full(2 * figures, float(tests))))
        for way, of_way in ((1.0, slice(None, figures)), (-1.0, slice(figures, None))):
            signs = np.array((way, way, 1.0, 1.0))[:, None]
            is_surer = sure[of_way] > surest
            surest = np.where(is_surer, sure[of_way], surest)
            found = np.where(is_surer, signs * told[:, of_way], found)
    return Steps(*found)


def _drawn_near(former: FloatArray, values: FloatArray) -> FloatArray:
    """Return the tests before a change with those far from the median of three neighbours nearer to it."""
    middle = np.median(np.stack((former[:-2], former[1:-1], former[2:])), axis=0)
    near = np.concatenate((middle[:1], middle, middle[-1:]))
    # by all tests: a change is one of their differences
    reach = _NEAR * OF_MEDIAN * np.median(np.abs(np.diff(values, axis=0)), axis=0) / np.sqrt(2.0)
    return np.asarray(np.clip(former, near - reach, near + reach), dtype=np.float64)
