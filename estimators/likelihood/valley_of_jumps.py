"""Walks along the bent valley of a stem that jumps: in unknowns that straighten it, steps are long and sills low."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.likelihood.bent_valley import chart_of, descend_bent
from estimators.likelihood.budget import Budget
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.valley import FARTHEST, LARGEST_RISE, Walk
from estimators.samples import FloatArray

# Own choices, from random valves that stick and slip.
FOR_JUMPS: Final = 3.0e6  # of work, along the valley
_FIRST: Final = 0.1  # of a logarithm
_LONGEST: Final = 0.4
_SHORTEST: Final = 0.01
_LONGER: Final = 1.5
_SHORTER: Final = 0.4
_MOST: Final = 16  # steps of a walk
_FOLLOWED: Final = 0.2  # of the cost
_FOLLOWING: Final = 80.0  # simulations
_TOO_HIGH: Final = 60.0  # of the cost: a shorter step stays in the valley
_LEAST_SHARE: Final = 1.0e-13


def is_charted(model: StemModel, point: FloatArray) -> bool:
    """Whether the stem jumps on the ramps at this point (p,), so that its valley can be walked as that of jumps."""
    return chart_of(model, point).charted(point) is not None


def walk_of_jumps(
    model: StemModel,
    start: Place,
    name: str,
    sense: int,
    *,
    budget: Budget,
    reserve: float = 0.0,
    largest_rise: float = LARGEST_RISE,
) -> Walk:
    """Follow the unknown ``name`` upwards or downwards from a low place until the cost has risen or it is far off.

    The force of the breakaway and the length of the jumps, which are straight, and all others follow. No places where
    the stem does not jump on the ramps.
    """
    chart, number = chart_of(model, start.point), model.coordinates.names.index(name)
    here, lowest, length, simulations = start, start.cost, _FIRST, 0
    places: list[Place] = []
    for _ in range(_MOST):
        own, slopes = chart.charted(here.point), model.slopes(here.point, one_sided=True)
        along = None if own is None else chart.slopes(own)
        simulations += here.point.size + 1
        if own is None or slopes is None or along is None:
            break
        tangent = _following(along @ slopes, along * model.coordinates.prior_weight @ along.T, number)
        reached: Place | None = None
        while reached is None and length >= _SHORTEST and budget.left - budget.price(model, simulations) > reserve:
            trial = chart.point(own + sense * length * tangent)
            if trial is not None and trial[number] != here.point[number]:
                found = descend_bent(model, trial, most_simulations=_FOLLOWING, arrived=_FOLLOWED, held=(name,))
                simulations += found.simulations
                if found.cost < lowest + _TOO_HIGH:
                    reached = Place(found.point, found.cost)
                    break
            length *= _SHORTER
        if reached is None:
            break
        places.append(reached)
        here, lowest = reached, min(lowest, reached.cost)
        far = abs(float(reached.point[number] - start.point[number])) + 1.0e-6
        if reached.cost > lowest + largest_rise or far >= FARTHEST:
            break
        length = min(_LONGER * length, _LONGEST, FARTHEST - far)
    budget.spend(model, simulations)
    return Walk(places, simulations)


def _following(charted: FloatArray, prior: FloatArray, number: int) -> FloatArray:
    """Change of all charted unknowns, shape (p,), while one goes on by 1 and the others follow."""
    normal = charted @ charted.T + prior
    free = np.diag(normal) > 0.0
    free[number] = False
    scale = np.sqrt(np.diag(normal)[free])
    tangent = np.zeros(normal.shape[0])
    tangent[number] = 1.0
    own = normal[np.ix_(free, free)] / np.outer(scale, scale)
    tangent[free] = np.linalg.lstsq(own, -normal[free, number] / scale, rcond=_LEAST_SHARE)[0] / scale
    return tangent
