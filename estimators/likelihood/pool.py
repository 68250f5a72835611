"""Many descents at once, of which the better go on: from the trial values to the few lowest places of the cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import without_outliers
from estimators.likelihood.descent import Descent, descend
from estimators.likelihood.model import StemModel
from estimators.likelihood.start import Trial
from estimators.samples import FloatArray

# Own choices, tried on random valves: trial values that are simulated, that are followed, and for how many steps.
_RANKED: Final = 240
_FEWEST_RANKED: Final = 30
_AT_ONCE: Final = 0.25  # of the budget, for one descent
_KEPT: Final = (20, 8, 4)
_STEPS: Final = (3, 5, 8)
_SAME: Final = 0.02  # of a coordinate that is a logarithm: two places are one
_SAME_YET: Final = 0.15  # and while places still change
_COARSE: Final = 0.3  # of the cost: a step that gains less can wait
_COMPARED: Final = ("m", "F_v", "F_c", "d", "DV")
_AT_LEAST: Final = 3  # are followed in any case
_RESERVE: Final = 0.35  # of the budget, for what comes after
_LOWER_LIMIT: Final = 3.0  # times lower, where a stem cannot be followed, and
_LOWERED: Final = 6  # so often
_MOVING_AT_FIRST: Final = ("m", "k", "F_v", "F_c", "d", "F_0")


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A point (p,) of the unknowns and its cost."""

    point: FloatArray
    cost: float


def chosen_trials(trials: list[Trial], most: int = _RANKED) -> list[Trial]:
    """Return at most so many trials, but some, spread evenly over all their classes (they come in order of these)."""
    most = min(max(most, _FEWEST_RANKED), _RANKED)
    if len(trials) <= most:
        return trials
    # a stride that shares no factor with the classes' numbers takes all of them in turn
    stride = max(1, len(trials) // most)
    while any(math.gcd(stride, classes) > 1 for classes in (2, 3, 5)):
        stride += 1
    count = min(most, len(trials))
    return [trials[(number * stride) % len(trials)] for number in range(count)]


def ranked(model: StemModel, trials: list[Trial], budget: Budget) -> list[Place]:
    """Return the trials' places, cheapest first, the best of each class of DV and of F_s before all others."""
    places = [Place(point, model.cost(point)) for point in (model.coordinates.point(trial.values) for trial in trials)]
    budget.spend(model, len(places))
    order = [number for number in np.argsort([place.cost for place in places]) if math.isfinite(places[number].cost)]
    firsts: dict[tuple[float, float], int] = {}
    for number in order:
        firsts.setdefault((trials[number].limit_share, trials[number].static_share), int(number))
    leading = list(firsts.values())
    return [places[number] for number in [*leading, *(number for number in order if number not in leading)]]


def halved(models: list[StemModel], places: list[Place], budget: Budget) -> list[Place]:
    """Follow many places for a few steps, the better of them for more; in each round on the next of the models.

    Of the models' parts without those that are far worse than most at the best place.
    """
    whole = budget.left
    for number, own in enumerate(models):
        model = without_outliers(own, places[0].point) if places else own
        kept, steps = _KEPT[min(number, len(_KEPT) - 1)], _STEPS[min(number, len(_STEPS) - 1)]
        names = model.coordinates.names
        held = tuple(name for name in names if name not in _MOVING_AT_FIRST) if number == 0 else ()
        followed: list[Place] = []
        for place in places[:kept]:
            if len(followed) >= _AT_LEAST and not budget.allows(_RESERVE, whole):
                break
            found = followed_from(model, _followable(model, place.point, budget), steps, budget, held=held)
            if math.isfinite(found.cost):
                followed.append(found)
        places = distinct(model, followed, _SAME_YET if number < len(models) - 1 else _SAME)
    return places


def _followable(model: StemModel, point: FloatArray, budget: Budget) -> FloatArray:
    """Return the point (p,), with a lower DV where the stem cannot be followed: below DV it chatters.

    Begun anew at each rest it may be followed, and through all of them not, although all else is right.
    """
    number = model.coordinates.names.index("DV")
    lowered = point.copy()
    for _ in range(_LOWERED):
        budget.spend(model, 1)
        if math.isfinite(model.cost(lowered)):
            return lowered
        lowered[number] -= math.log(_LOWER_LIMIT)
    return point


def followed_from(
    model: StemModel, point: FloatArray, steps: int, budget: Budget, *, held: tuple[str, ...] = (), fine: bool = False
) -> Place:
    """Return where a descent from this point (p,) ends."""
    found: Descent = descend(
        model,
        point,
        most_steps=steps,
        held=held,
        arrived=0.1 * _COARSE if fine else _COARSE,
        one_sided=True,
        most_simulations=budget.most_at_once(model, _AT_ONCE),
    )
    budget.spend(model, found.simulations)
    budget.starts += 1
    return Place(found.point, found.cost)


def distinct(model: StemModel, places: list[Place], apart: float = _SAME) -> list[Place]:
    """Return the places, cheapest first, without those at which a cheaper one is already."""
    compared = [model.coordinates.names.index(name) for name in _COMPARED]
    ordered = sorted(places, key=lambda one: one.cost)
    points = np.array([place.point[compared] for place in ordered]).reshape(len(ordered), len(compared))
    kept: list[int] = []
    for number, point in enumerate(points):
        if not bool((np.abs(points[kept] - point) < apart).all(axis=1).any()):
            kept.append(number)
    return [ordered[number] for number in kept]
