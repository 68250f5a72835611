"""From a low place of the cost to where it may be as low, again and again, and down the valley from there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.bent_valley import descend_bent
from estimators.likelihood.budget import Budget
from estimators.likelihood.descent import Descent
from estimators.likelihood.hops import hops
from estimators.likelihood.jump_simplex import down_by_simplex
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place, distinct, followed_from
from estimators.likelihood.valley import STRAIGHT, Way, led_down
from estimators.likelihood.valley_of_jumps import is_charted, walk_of_jumps
from estimators.samples import FloatArray

# Own choices.
_HOP_STEPS: Final = ((36, 2), (8, 5), (3, 8))  # how many are followed, and for how many steps
_SCAN_STEPS: Final = 7
LAST_SHARE: Final = 0.15  # of the budget
_LED_OF_JUMPS: Final = 2  # places that are led down: the valley of jumps has sills
_VALLEY_STEPS: Final = 30  # F_v, F_c and DV of jumps lie in a narrow valley
_HOP_ROUNDS: Final = 3
_AT_ONCE: Final = 0.15  # of the budget, for one way along the valley of jumps
_BETTER: Final = 1.0  # of the cost: a hop that gains less is at the same place
_SCAN: Final = np.concatenate([np.linspace(-0.05, 0.05, 21), np.linspace(-0.4, 0.8, 13)])  # of F_s


@dataclass(frozen=True, slots=True)
class Hopping:
    """What a hop has to know: the usual sliding speed, whether the stem jumps from rest to rest, the slowest ramp."""

    speed_m_per_s: float
    jumps: bool
    slowest_n_per_s: float = math.inf


def hopped(
    small: StemModel,
    places: list[Place],
    hopping: Hopping,
    budget: Budget,
    whole: float,
    *,
    reserve: float = LAST_SHARE,
) -> list[Place]:
    """Hop from the best place until none is lower, and return all that were found, cheapest first.

    No round begins where less than the ``reserve`` of the ``whole`` budget is left.
    """
    for _ in range(_HOP_ROUNDS):
        if not places or not budget.allows(reserve, whole):
            break
        best = places[0]
        found = [Place(point, 0.0) for point in hops(small, best.point, hopping.speed_m_per_s, jumps=hopping.jumps)]
        for kept, steps in _HOP_STEPS:
            found = distinct(small, _followed(small, found[:kept], steps, budget, fine=kept < 5))
        places = distinct(small, [*places, *found])
        lowest = [followed_from(small, place.point, _VALLEY_STEPS, budget, fine=True) for place in places[:2]]
        places = distinct(small, [*lowest, *places])
        if places[0].cost > best.cost - _BETTER:
            break
    if places and hopping.jumps:
        led = [led_along_jumps(small, one, budget, reserve * whole) for one in places[:_LED_OF_JUMPS]]
        places = distinct(small, [*led, *places])
    elif places:
        places = distinct(small, [led_along_jumps(small, places[0], budget, reserve * whole), *places])
    return places


def led_along_jumps(small: StemModel, place: Place, budget: Budget, reserve: float) -> Place:
    """Go down from a low place of a stem that jumps, in the unknowns that its jumps show, and walk from there."""
    if not is_charted(small, place.point):
        return led_down(small, place, STRAIGHT, budget, reserve)
    found = _down_bent(small, place.point, most_simulations=budget.most_at_once(small, _AT_ONCE))
    budget.spend(small, found.simulations)
    lower = Place(found.point, found.cost) if found.cost < place.cost else place
    lower = down_by_simplex(small, lower, budget, reserve)
    return led_down(small, lower, Way(walk_of_jumps, _down_bent), budget, reserve)


def _down_bent(model: StemModel, start: FloatArray, *, most_simulations: float) -> Descent:
    return descend_bent(model, start, most_simulations=most_simulations, arrived=_BETTER)


def _followed(small: StemModel, places: list[Place], steps: int, budget: Budget, *, fine: bool) -> list[Place]:
    """Follow these places for so many steps, as many of them as the budget lets."""
    found: list[Place] = []
    for place in places:
        if budget.left < 0.0:
            break
        followed = followed_from(small, place.point, steps, budget, fine=fine)
        if math.isfinite(followed.cost):
            found.append(followed)
    return found


def with_scanned_friction(model: StemModel, place: Place, budget: Budget) -> Place:
    """Scan F_s on the cost of the position, which has one minimum in it, and descend from there."""
    number = model.coordinates.names.index("d")
    ratio = 1.0 + place.point[number]
    best = place
    for share in _SCAN:
        trial = place.point.copy()
        trial[number] = max(0.0, ratio * (1.0 + share) - 1.0)
        cost = model.cost(trial)
        if cost < best.cost:
            best = Place(trial, cost)
    budget.spend(model, _SCAN.size)
    return place if best is place else followed_from(model, best.point, _SCAN_STEPS, budget)
