"""Walks along the bent valley of a stem that jumps: in unknowns that straighten it, steps are long and sills low."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.likelihood.bent_valley import chart_of, descend_bent
from estimators.likelihood.budget import Budget
from estimators.likelihood.jump_chart import CHARTED, JumpChart
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
_FAINT: Final = 0.003  # damping ratio
_FARTHER: Final = 3  # times a factor of 10, where the cost has not risen there
_ALL_THE_WAY: Final = 0.99
_LEAST_SHARE: Final = 1.0e-13


def is_charted(model: StemModel, point: FloatArray) -> bool:
    """Whether the stem jumps on the ramps at this point (p,), so that its valley can be walked as that of jumps."""
    if not set(CHARTED) <= set(model.coordinates.names):
        return False
    return chart_of(model, point).charted(point) is not None


def far_walk_of_jumps(
    model: StemModel, start: Place, name: str, sense: int, *, budget: Budget, within: float
) -> list[Place]:
    """Return the places of a walk that goes on until the cost has risen by ``within``; F_v from where it may show."""
    here, places = start, list[Place]()
    number = model.coordinates.names.index(name)
    shown = _with_faint_damping(model, start.point) if name == "F_v" and sense > 0 else None
    if shown is not None and shown.cost < start.cost + within:
        here = shown
        places.append(shown)
    for _ in range(1 + _FARTHER):
        rise = here.cost - start.cost
        on = walk_of_jumps(model, here, name, sense, budget=budget, largest_rise=2.0 * within - rise).places
        places += on
        if not on or on[-1].cost > start.cost + within:
            break
        if abs(float(on[-1].point[number] - here.point[number])) < _ALL_THE_WAY * FARTHEST:
            break
        here = on[-1]
    return places


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
        alone = np.zeros(tangent.size)
        alone[number] = 1.0
        reached: Place | None = None
        while reached is None and length >= _SHORTEST and budget.left - budget.price(model, simulations) > reserve:
            trial = _lower_of(model, chart, own, [sense * length * tangent, sense * length * alone])
            simulations += 2
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


def _lower_of(model: StemModel, chart: JumpChart, own: FloatArray, steps: list[FloatArray]) -> FloatArray | None:
    """Return the point (p,) to which the best of these steps of the charted point leads; None where none leads to one.

    At a kink of the cost the slopes are those of one side, and the step in which the others follow is the worse one.
    """
    points = [point for point in (chart.point(own + step) for step in steps) if point is not None]
    return min(points, key=model.cost, default=None)


def _with_faint_damping(model: StemModel, point: FloatArray) -> Place | None:
    """Return this point (p,) with the least F_v that may show, its breakaway and jumps the same.

    None where it has as much. Of a logarithm far below that no walk comes to where it counts.
    """
    values, number = model.coordinates.values(point), model.coordinates.names.index("F_v")
    faint = _FAINT * 2.0 * math.sqrt(values["m"] * values["k"])
    chart = chart_of(model, point)
    own = chart.charted(point)
    if own is None or values["F_v"] >= faint:
        return None
    own[number] = math.log(faint)
    shown = chart.point(own)
    return None if shown is None else Place(shown, model.cost(shown))


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
