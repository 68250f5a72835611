"""Places far from a fit that no walk along its slopes finds: another F_s, a DV across a cliff, teeth of a comb."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np

from estimators.likelihood.budget import Budget
from estimators.likelihood.descent import descend
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.valley import along
from estimators.samples import FloatArray

FOLLOWING_STEPS: Final = 10
_TOOTHED: Final = ("F_v", "DV")
_TEETH_SIGMAS: Final = (-30.0, -10.0, 10.0, 30.0)
_LONGEST_TOOTH: Final = 0.4  # of a logarithm
_OTHER_STICTION: Final = ((0.25, 0.0), (0.7, 0.0), (1.0, 0.05), (1.0, 0.4))  # factors of F_s/F_c - 1, and added to it
_NEAR_SPEED: Final = 0.93  # of the slowest ramp's
_VISCOUS_SHARES: Final = (0.1, 0.3)  # of the friction in motion
_OTHER_LIMITS: Final = (1.02, 1.05, 1.1, 1.2, 1.4)  # factors of DV; farther it is not known to 30 %
_FACTORS: Final = (0.5, 0.7, 1.4, 2.0)  # of what the slopes say is known
_OTHER_MASSES: Final = (1.003, 1.006, 1.01, 1.02)  # factors of m; a tooth is narrower than the first
_LOWER_TOOTH: Final = 1.0  # of the cost


def with_other_stiction(small: StemModel, point: FloatArray, budget: Budget) -> Iterator[Place]:
    """Yield where the others go with an F_s far off: under a step it may not show at all up to a sharp limit."""
    number = small.coordinates.names.index("d")
    for factor, more in _OTHER_STICTION:
        if budget.left > 0.0:
            other = point.copy()
            other[number] = factor * point[number] + more
            yield _followed_beside(small, other, "d", budget)


def with_other_value(small: StemModel, point: FloatArray, name: str, budget: Budget) -> Iterator[Place]:
    """Yield where the others go with quite another value of an unknown that the slopes say is known.

    Few jumps, or small ones, make kinks of the cost: its slopes there tell of a narrow valley, and no walk along them
    comes out of it, where another value explains the rows as well or better.
    """
    number = small.coordinates.names.index(name)
    for factor in _FACTORS:
        if budget.left > 0.0:
            other = point.copy()
            other[number] += math.log(factor)
            yield _followed_beside(small, other, name, budget)


def with_limit_at_speed(model: StemModel, point: FloatArray, speed_m_per_s: float, budget: Budget) -> Iterator[Place]:
    """Yield where the others go with a DV just below the slowest ramp's speed, at one friction in motion.

    The stem breaks away undamped there, and F_v may be any beside F_c: a hump may lie between, over which no walk goes.
    """
    values = model.coordinates.values(point)
    friction_n = values["F_c"] + values["F_v"] * speed_m_per_s
    for share in _VISCOUS_SHARES:
        if budget.left < 0.0 or not math.isfinite(speed_m_per_s):
            break
        coulomb_n = (1.0 - share) * friction_n
        static_n = max(values["F_c"] * (1.0 + values["d"]), friction_n)
        other = {"DV": _NEAR_SPEED * speed_m_per_s, "F_v": share * friction_n / speed_m_per_s, "F_c": coulomb_n}
        start = model.coordinates.point(values | other | {"d": static_n / coulomb_n - 1.0})
        yield _followed_beside(model, start, "DV", budget)


def with_other_limits(small: StemModel, start: Place, sense: int, budget: Budget, within: float) -> list[Place]:
    """Return places with a higher DV (``sense`` 1) or a lower one, all else at its best; from the start on.

    A DV at a ramp's speed is at a cliff: below it the stem slides. The slopes there are the cliff's, and along these
    no walk finds the higher DVs, with which a stem that creeps moves alike. They end where the cost has risen by
    ``within``; where it has at once, the slopes tell how far DV goes, and the start alone is returned.
    """
    number = small.coordinates.names.index("DV")
    places = [start]
    for factor in _OTHER_LIMITS:
        if budget.left < 0.0 or places[-1].cost > start.cost + within:
            break
        trial = places[-1].point.copy()
        trial[number] = start.point[number] + sense * math.log(factor)
        places.append(_followed_beside(small, trial, "DV", budget))
    return places if places[:2][-1].cost <= start.cost + within else [start]


def _followed_beside(model: StemModel, start: FloatArray, held: str, budget: Budget) -> Place:
    """Return where the others go from this start, shape (p,), while the one unknown stays."""
    found = descend(model, start, most_steps=FOLLOWING_STEPS, held=(held,), arrived=0.1, one_sided=True)
    budget.spend(model, found.simulations)
    return Place(found.point, found.cost)


def is_lowest_tooth(model: StemModel, point: FloatArray) -> bool:
    """Whether no tooth beside this one, at a somewhat larger or smaller m, costs less on all rows.

    Of a stem that creeps each jump makes a kink of the cost, and the slopes at the bottom of a tooth are those of its
    kinks: they may tell of a valley 20 times narrower than the one that the teeth lie in, and blocks of rows chosen by
    them have other teeth. Differences to both sides lead from beyond the tooth to what the next ones leave.
    """
    number = model.coordinates.names.index("m")
    here = model.cost(point)
    for sense in (-1, 1):
        last = point
        for factor in _OTHER_MASSES:
            trial = last.copy()
            trial[number] = point[number] + sense * math.log(factor)
            found = descend(model, trial, most_steps=FOLLOWING_STEPS, held=("m",), arrived=0.1)
            if found.cost < here - _LOWER_TOOTH:
                return False
            if found.cost > here + _LOWER_TOOTH:
                break
            last = found.point
    return True


def next_teeth(small: StemModel, point: FloatArray, budget: Budget) -> Iterator[Place]:
    """Yield where descents end that begin many standard errors off along the valley, beyond its sills."""
    names = small.coordinates.names
    for name, sigmas in product(_TOOTHED, _TEETH_SIGMAS):
        tangent = along(small, point, names.index(name), list(range(len(names))))
        if tangent is None or budget.left < 0.0:
            break
        step = float(np.clip(sigmas * tangent[1], -_LONGEST_TOOTH, _LONGEST_TOOTH))
        trial = point + step * tangent[0]
        found = descend(small, trial, most_steps=FOLLOWING_STEPS, arrived=0.1, one_sided=True)
        budget.spend(small, found.simulations)
        yield Place(found.point, found.cost)
