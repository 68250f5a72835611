"""Levenberg's and Marquardt's descent with bounds, on the normal equations of few unknowns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.model import STEP, StemModel
from estimators.likelihood.step_kernel import bounded_step
from estimators.samples import FloatArray

# Own choice: what counts as arrived.
_ARRIVED: Final = 1.0e-3  # of a unit of the cost, whose minimum is uncertain by the number of unknowns
_MOST_DAMPING: Final = 1.0e12
_AT_A_CLIFF: Final = 3  # steps on end that lead higher, each a part of the one before, at the end of a descent


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended: ``point`` (p,), its cost, and how many simulations it took."""

    point: FloatArray
    cost: float
    simulations: int
    arrived: bool
    rejected: int = 0  # steps that led higher before the last one


def descend(
    model: StemModel,
    start: FloatArray,
    *,
    most_steps: int,
    held: tuple[str, ...] = (),
    arrived: float = _ARRIVED,
    one_sided: bool = False,
    most_simulations: float = math.inf,
    difference: float = STEP,
) -> Descent:
    """Return the lowest point reached from ``start`` (p,) within ``most_steps`` evaluations of the derivatives.

    It has arrived where a step gains less than ``arrived`` of the cost. One-sided differences cost half as much. It
    ends soon after ``most_simulations``. ``difference`` is the step of the derivatives' differences.

    The first speed of a section near DV is at a cliff: a stem that begins slower, or the other way, rests there first.
    Where all steps over it lead higher the descent goes on without it.
    """
    found = _descend(
        model,
        start,
        most_steps=most_steps,
        held=held,
        arrived=arrived,
        one_sided=one_sided,
        most_simulations=most_simulations,
        difference=difference,
    )
    speeds = tuple(name for name in model.coordinates.names if name.startswith("v_") and name not in held)
    if found.rejected < _AT_A_CLIFF or not speeds:
        return found
    further = _descend(
        model,
        found.point,
        most_steps=most_steps,
        held=(*held, *speeds),
        arrived=arrived,
        one_sided=one_sided,
        most_simulations=most_simulations - found.simulations,
        difference=difference,
    )
    simulations = found.simulations + further.simulations
    return replace(further if further.cost < found.cost else found, simulations=simulations)


def _descend(
    model: StemModel,
    start: FloatArray,
    *,
    most_steps: int,
    held: tuple[str, ...],
    arrived: float,
    one_sided: bool,
    most_simulations: float,
    difference: float,
) -> Descent:
    names = model.coordinates.names
    moving = [number for number, name in enumerate(names) if name not in held]
    may_move = np.zeros(len(names), dtype=np.bool_)
    may_move[moving] = True
    lower, upper = model.coordinates.lower, model.coordinates.upper
    longest = model.coordinates.longest_step
    prior, weight = model.coordinates.prior, model.coordinates.prior_weight
    point = np.clip(start, lower, upper)
    here = model.simulate(point)
    simulations = 1
    if here is None:
        return Descent(point, float("inf"), simulations, False)
    residual = model.left_by(here)
    cost = float(residual @ residual) + model.prior_cost(point)
    damping, growth, known, rejected = 1.0e-3, 2.0, np.diag(weight), 0
    differences = np.full(point.size, difference)
    for _ in range(most_steps):
        if simulations > most_simulations:
            break
        slopes = model.slopes(point, moving, differences, one_sided=one_sided, here=here)
        simulations += (1 if one_sided else 2) * len(moving)
        if slopes is None:
            break
        normal = slopes @ slopes.T + known
        pull = slopes @ residual - weight * (point - prior)
        accepted, rejected = False, 0
        while damping < _MOST_DAMPING and simulations <= most_simulations:
            step = bounded_step(normal, pull, damping, may_move, point, lower, upper, longest)
            trial = np.clip(point + step, lower, upper)
            step = trial - point
            gain = float(2.0 * pull @ step - step @ normal @ step)
            if gain <= arrived * 1.0e-3 or not np.abs(step).max() > 1.0e-13:
                return Descent(point, cost, simulations, True, rejected)
            there = model.simulate(trial)
            simulations += 1
            trial_cost, trial_residual = float("inf"), residual
            if there is not None:
                trial_residual = model.left_by(there)
                trial_cost = float(trial_residual @ trial_residual) + model.prior_cost(trial)
            if there is not None and trial_cost < cost:
                ratio = (cost - trial_cost) / gain
                damping *= max(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3)
                damping, growth = max(damping, 1.0e-12), 2.0
                fall = cost - trial_cost
                point, here, residual, cost, accepted = trial, there, trial_residual, trial_cost, True
                if fall < arrived and gain < arrived:
                    return Descent(point, cost, simulations, True, rejected)
                break
            rejected += 1
            if gain < arrived:
                return Descent(point, cost, simulations, True, rejected)
            damping *= growth
            growth *= 2.0
        if not accepted:
            break
    return Descent(point, cost, simulations, False, rejected)
