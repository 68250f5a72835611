"""Walks along the valley of the cost: one unknown goes on step by step, all others follow, while it costs little."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Final, Protocol

import numpy as np

from estimators.likelihood.budget import Budget
from estimators.likelihood.descent import Descent, descend
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.samples import FloatArray

# Own choices, from random valves that stick and slip.
WALKED: Final = ("F_v", "m", "DV")
LARGEST_RISE: Final = 12.0  # of the cost: behind a low sill the bottom may be lower
_LOWER: Final = 0.5  # of the cost
_DOWN_STEPS: Final = 20
_ROUNDS: Final = 4
_TOO_HIGH: Final = 60.0  # of the cost: the straight step left the bent valley, a shorter one does not
_FIRST_SIGMAS: Final = 1.0
_LONGEST: Final = 0.4  # of a logarithm
_SHORTEST: Final = 0.003
_LONGER: Final = 1.7
_STEPS: Final = 6  # of the others' descent
_FOLLOWED: Final = 0.2  # of the cost
_AT_ONCE: Final = 0.5  # of the budget, for one descent
_MOST: Final = 14  # steps of a walk
FARTHEST: Final = 2.3  # of a logarithm, 10 times
_LEAST_SHARE: Final = 1.0e-13


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """The places of a walk in order, without its start, and how many simulations it took."""

    places: list[Place]
    simulations: int


class Walking(Protocol):
    """How a walk goes along one unknown: ``walk``, or another way that keeps to the valley."""

    def __call__(  # noqa: D102 - the class says what it does
        self, model: StemModel, start: Place, name: str, sense: int, *, budget: Budget, reserve: float
    ) -> Walk: ...


class Descending(Protocol):
    """How the bottom is reached from a lower place: within so many simulations."""

    def __call__(self, model: StemModel, start: FloatArray, *, most_simulations: float) -> Descent: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Way:
    """How a valley is gone along, and down."""

    walking: Walking
    descending: Descending


def led_down(model: StemModel, start: Place, way: Way, budget: Budget, reserve: float) -> Place:
    """Walk from a low place both ways along each unknown, and go down from wherever that is lower, again and again.

    It ends where no walk leads lower, or where no more than ``reserve`` of the budget is left.
    """
    best = start
    for _ in range(_ROUNDS):
        before = best.cost
        for name, sense in product(WALKED, (1, -1)):
            if budget.left < reserve:
                return best
            walked = way.walking(model, best, name, sense, budget=budget, reserve=reserve)
            lowest = min(walked.places, key=lambda place: place.cost, default=best)
            if lowest.cost < best.cost - _LOWER:
                found = way.descending(model, lowest.point, most_simulations=budget.most_at_once(model, _AT_ONCE))
                budget.spend(model, found.simulations)
                best = Place(found.point, found.cost)
        if best.cost > before - _LOWER:
            break
    return best


def walk(
    model: StemModel,
    start: Place,
    name: str,
    sense: int,
    *,
    budget: Budget,
    reserve: float = 0.0,
    held: tuple[str, ...] = (),
    largest_rise: float = LARGEST_RISE,
    longest: float = _LONGEST,
) -> Walk:
    """Follow the unknown ``name`` upwards or downwards from a low place until the cost has risen or it is far off.

    It ends too where no more than ``reserve`` of the budget is left. No step of the logarithm is longer than
    ``longest``.
    """
    number = model.coordinates.names.index(name)
    moving = [other for other, own in enumerate(model.coordinates.names) if own not in held]
    lower, upper = model.coordinates.lower, model.coordinates.upper
    here, lowest = start, start.cost
    places: list[Place] = []
    length, simulations = math.nan, 0
    for _ in range(_MOST):
        if budget.left - budget.price(model, simulations) < reserve:
            break
        way = along(model, here.point, number, moving)
        simulations += len(moving) + 2
        if way is None:
            break
        tangent, sigma = way
        length = min(max(_FIRST_SIGMAS * sigma, _SHORTEST), longest) if math.isnan(length) else length
        reached: Place | None = None
        while length >= _SHORTEST:
            trial = np.clip(here.point + sense * length * tangent, lower, upper)
            if trial[number] == here.point[number]:
                break
            followed = descend(model, trial, most_steps=_STEPS, held=(name, *held), arrived=_FOLLOWED, one_sided=True)
            simulations += followed.simulations
            if followed.cost < lowest + _TOO_HIGH:
                reached = Place(followed.point, followed.cost)
                break
            length *= 0.4
        if reached is None:
            break
        places.append(reached)
        here, lowest = reached, min(lowest, reached.cost)
        far = abs(float(reached.point[number] - start.point[number])) + 1.0e-6
        if reached.cost > lowest + largest_rise or far >= FARTHEST:
            break
        length = min(_LONGER * length, longest, FARTHEST - far)
    budget.spend(model, simulations)
    return Walk(places, simulations)


def _down(model: StemModel, start: FloatArray, *, most_simulations: float) -> Descent:
    """Descend from the lowest place of a walk, point (p,)."""
    return descend(
        model, start, most_steps=_DOWN_STEPS, one_sided=True, arrived=_FOLLOWED, most_simulations=most_simulations
    )


def along(model: StemModel, point: FloatArray, number: int, moving: list[int]) -> tuple[FloatArray, float] | None:
    """Change of all unknowns, shape (p,), while one goes on by 1 and the others follow, and its standard error."""
    slopes = model.slopes(point, moving, one_sided=True)
    if slopes is None:
        return None
    normal = slopes @ slopes.T + np.diag(model.coordinates.prior_weight)
    lower, upper = model.coordinates.lower, model.coordinates.upper
    free = (np.diag(normal) > 0.0) & (lower < point) & (point < upper)
    free[number] = False
    tangent = np.zeros(point.size)
    tangent[number] = 1.0
    scale = np.sqrt(np.diag(normal)[free])
    own = normal[np.ix_(free, free)] / np.outer(scale, scale)
    right = -normal[free, number] / scale
    tangent[free] = np.linalg.lstsq(own, right, rcond=_LEAST_SHARE)[0] / scale
    bend = float(tangent @ normal @ tangent)
    return tangent, 1.0 / math.sqrt(bend) if bend > 0.0 else math.inf


STRAIGHT: Final = Way(walk, _down)
