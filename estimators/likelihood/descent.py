"""Levenberg's and Marquardt's descent with bounds, on the normal equations of few unknowns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.model import STEP, StemModel
from estimators.samples import FloatArray

# Own choice: what counts as arrived.
_ARRIVED: Final = 1.0e-3  # of a unit of the cost, whose minimum is uncertain by the number of unknowns
_MOST_DAMPING: Final = 1.0e12


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended: ``point`` (p,), its cost, and how many simulations it took."""

    point: FloatArray
    cost: float
    simulations: int
    arrived: bool


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
    """
    names = model.coordinates.names
    moving = [number for number, name in enumerate(names) if name not in held]
    lower, upper = model.coordinates.lower, model.coordinates.upper
    longest = model.coordinates.longest_step
    prior, weight = model.coordinates.prior, model.coordinates.prior_weight
    point = np.clip(start, lower, upper)
    residual = model.residuals(point)
    simulations = 1
    if residual is None:
        return Descent(point, float("inf"), simulations, False)
    cost = float(residual @ residual) + model.prior_cost(point)
    damping, growth = 1.0e-3, 2.0
    differences = np.full(point.size, difference)
    for _ in range(most_steps):
        if simulations > most_simulations:
            break
        slopes = model.slopes(point, moving, differences, one_sided=one_sided)
        simulations += (1 if one_sided else 2) * len(moving) + 1
        if slopes is None:
            break
        normal = slopes @ slopes.T + np.diag(weight)
        pull = slopes @ residual - weight * (point - prior)
        accepted = False
        while damping < _MOST_DAMPING and simulations <= most_simulations:
            step = _bounded_step(normal, pull, damping, (moving, point, lower, upper, longest))
            trial = np.clip(point + step, lower, upper)
            step = trial - point
            gain = float(2.0 * pull @ step - step @ normal @ step)
            if gain <= arrived * 1.0e-3 or not np.abs(step).max() > 1.0e-13:
                return Descent(point, cost, simulations, True)
            trial_residual = model.residuals(trial)
            simulations += 1
            trial_cost = float("inf")
            if trial_residual is not None:
                trial_cost = float(trial_residual @ trial_residual) + model.prior_cost(trial)
            if trial_residual is not None and trial_cost < cost:
                ratio = (cost - trial_cost) / gain
                damping *= max(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3)
                damping, growth = max(damping, 1.0e-12), 2.0
                fall = cost - trial_cost
                point, residual, cost, accepted = trial, trial_residual, trial_cost, True
                if fall < arrived and gain < arrived:
                    return Descent(point, cost, simulations, True)
                break
            if gain < arrived:
                return Descent(point, cost, simulations, True)
            damping *= growth
            growth *= 2.0
        if not accepted:
            break
    return Descent(point, cost, simulations, False)


def _bounded_step(
    normal: FloatArray,
    pull: FloatArray,
    damping: float,
    where: tuple[list[int], FloatArray, FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """The damped step; an unknown that would leave its bounds goes to the bound, the others' step is solved anew.

    ``where`` are the numbers of the unknowns that may move, the point, the bounds, and the longest steps.
    """
    moving, point, lower, upper, longest = where
    step = np.zeros(point.size)
    fixed: set[int] = {i for i in range(point.size) if i not in moving or not normal[i, i] > 0.0}
    for _ in range(point.size):
        free = [i for i in range(point.size) if i not in fixed]
        if not free:
            break
        own = normal[free][:, free]
        scale = np.sqrt(np.diag(own))
        damped = own / np.outer(scale, scale) + damping * np.eye(len(free))
        held = [i for i in range(point.size) if i in fixed and step[i] != 0.0]
        right = (pull[free] - normal[free][:, held] @ step[held]) / scale
        try:
            step[free] = np.linalg.solve(damped, right) / scale
        except np.linalg.LinAlgError:
            step[free] = right / scale / (1.0 + damping)
        excess = float((np.abs(step[free]) / longest[free]).max())
        if excess > 1.0:
            step[free] /= excess
        out = [i for i in free if not lower[i] <= point[i] + step[i] <= upper[i]]
        if not out:
            break
        for i in out:
            step[i] = (lower[i] if point[i] + step[i] < lower[i] else upper[i]) - point[i]
        fixed.update(out)
    return step
