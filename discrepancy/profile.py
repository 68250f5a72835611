"""The valley of a cause's parameters, walked both ways: its lowest place, and how far it goes before the cost rises.

The information at a point is that of one bend. Where a valley is curved, a descent ends on its side, and the interval
there tells of the short way across and not of the long one along it. Profile likelihood: a parameter of the cause goes
on, the others follow, and all intervals hold what costs less than 3.84 more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from discrepancy.choice import Choice
from discrepancy.intervals import with_errors_and_ways
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.rounds import is_possible
from discrepancy.setting import setting_of
from discrepancy.significance import noise_factor
from discrepancy.unknowns import SEPARATOR
from estimators.base import NORMAL_95
from estimators.samples import FloatArray

_WITHIN_95: Final = 3.84  # of the cost, in units of what is left as noise
_LOWER: Final = 1.0  # of the cost: that much lower the fit was not at the bottom
# Own choices, from blind cases (docs/diagnosis.md).
_MOST_ANEW: Final = 4
_STRAIGHT: Final = (0.95, 1.05)  # times 3.84: so much the cost is higher where a straight valley's interval ends
_STRIDES: Final = 5  # one way, each as long as the interval at the point
_FOLLOWING_STEPS: Final = 8
_STEPS: Final = 20
_MOST_WORK: Final = 2.0e7  # passes: two to four seconds


def at_the_lowest(choice: Choice) -> Choice:
    """Return the choice with its last fit at the lowest of its valley; as it is where no valve could be like that."""
    if not choice.causes:
        return choice
    lowest = profiled(choice.best)
    setting = setting_of(lowest)
    if not all(is_possible(cause, lowest, setting) for cause in choice.causes):
        return choice
    return replace(choice, best=lowest)


def profiled(fit: Fit) -> Fit:
    """Return the lowest fit that the walks come to, with the least standard errors that they leave."""
    last = fit.model.tally.work + _MOST_WORK
    walks: list[list[Fit]] = []
    for _ in range(_MOST_ANEW):
        walks = []
        lower = None
        for walk in _walks(fit, last):
            walks.append(walk)
            lowest = min(walk, key=lambda one: one.cost)
            if lowest.cost < fit.cost - _LOWER * noise_factor(fit):
                lower = descend(lowest, most_steps=_STEPS)
                break
        if lower is None:
            break
        fit = lower
    least = np.zeros(fit.point.size)
    for walk in walks:
        for point in _within(fit, walk):
            least = np.maximum(least, np.abs(point - fit.point) / NORMAL_95)
    return replace(fit, least_errors=least)


def _walks(fit: Fit, last: float) -> Iterator[list[Fit]]:
    """Yield the fits of each walk from this one on, until its cost is above what the intervals hold."""
    fit, errors, ways = with_errors_and_ways(fit)
    names = fit.model.unknowns.names
    for place in (number for number, name in enumerate(names) if SEPARATOR in name and math.isfinite(errors[number])):
        for sense in (-1.0, 1.0):
            if fit.model.tally.work > last:
                return
            yield list(_walk(fit, place, ways[place], sense * NORMAL_95 * float(errors[place])))


def _walk(fit: Fit, place: int, along: FloatArray, stride: float) -> Iterator[Fit]:
    unknowns, before, here = fit.model.unknowns, fit, fit
    yield fit
    end = start_fit(fit.model, np.clip(fit.point + along * stride, unknowns.lower, unknowns.upper))
    if _is_straight(fit, end):
        yield end
        return
    for number in range(_STRIDES):
        # on from the last two places: the valley bends
        ahead = along * stride if number == 0 else here.point - before.point
        trial = np.clip(here.point + ahead, unknowns.lower, unknowns.upper)
        if trial[place] == here.point[place]:
            return
        following = descend(
            start_fit(fit.model, trial), most_steps=_FOLLOWING_STEPS, held=frozenset({unknowns.names[place]})
        )
        if not following.is_followed:
            return
        before, here = here, following
        yield here
        if here.cost - fit.cost > _WITHIN_95 * noise_factor(fit):
            return


def _is_straight(fit: Fit, end: Fit) -> bool:
    """Whether the cost rises to the end of the interval at the point as its information says: no walk is needed."""
    rise = (end.cost - fit.cost) / (_WITHIN_95 * noise_factor(fit))
    return _STRAIGHT[0] < rise < _STRAIGHT[1]


def _within(fit: Fit, walk: list[Fit]) -> Iterator[FloatArray]:
    """Yield the points of a walk that the interval holds, and where it ends between two of them, linear in its root."""
    most = fit.cost + _WITHIN_95 * noise_factor(fit)
    for before, after in pairwise(walk):
        if after.cost <= most:
            yield after.point
        elif before.cost <= most:
            begun, end, whole = (math.sqrt(max(cost - fit.cost, 0.0)) for cost in (before.cost, after.cost, most))
            share = (whole - begun) / (end - begun)
            yield before.point + share * (after.point - before.point)
