"""The end of a search on all rows of the recording: a few places, with precise positions down to the bottom."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from estimators.likelihood.budget import Budget
from estimators.likelihood.certificate import Certificate, certify
from estimators.likelihood.compression import LEAST_NOISE, bent_rows, compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.model import NO_NOISE, StemModel
from estimators.likelihood.pool import Place, distinct
from estimators.samples import FloatArray

# Own choices.
EXACT: Final = 0.1  # of the noise: only without noise, and then nothing can be better
NEAR: Final = 25.0  # of the cost: a place that may be the right one
MOST_PLACES: Final = 4
_ON_ALL_ROWS: Final = 0.6  # of the budget, for one descent
_MOST_OVERDRAWN: Final = 0.3  # of the budget: then no other place is followed on all rows
_LAST_STEPS: Final = 20
_NEARLY: Final = 0.1  # of the cost: from where on differences have to be good
_ALL_BUT: Final = 0.5
_SHARPER: Final = 1.0e3  # weights: of a position without noise
_FINE_STEPS: Final = 120  # of a precise position: the valley of DV and F_s is narrow and bent
_MOST_FINE: Final = 5  # times the simulations of a descent with noise
_DEARER: Final = 3  # times the rows of blocks: uneven rows that many more are not simulated at each step


def is_computed(model: StemModel) -> bool:
    """Whether the position has no noise but the floor that stands for it."""
    return float(model.weight.max()) * model.range_m > _ALL_BUT / NO_NOISE


def exactly(model: StemModel) -> float:
    """Misfit, in times the noise, below which no other place can be better: without noise, that of the floor."""
    return 1.0 if is_computed(model) else EXACT


def on_all_rows(model: StemModel, places: list[Place], budget: Budget) -> list[Place]:
    """Descend on all rows from the places that may be the lowest; cheapest first."""
    ended: list[Place] = []
    computed, exact = is_computed(model), exactly(model)
    is_precise = float(model.weight.max()) * model.range_m > 1.0 / LEAST_NOISE
    near_by = places[:MOST_PLACES]
    if places and not is_precise:
        near_by = _on_telling_blocks(model, near_by, budget)
    for number, place in enumerate(near_by):
        is_far = number > 0 and place.cost > near_by[0].cost + 2.0 * NEAR
        if is_far or (ended and ended[0].cost < exact**2 * model.time_s.size):
            break
        if ended and budget.left < -_MOST_OVERDRAWN * budget.whole:
            break
        most = budget.most_at_once(model, _ON_ALL_ROWS)
        near = descend(
            model, place.point, most_steps=_LAST_STEPS, one_sided=True, arrived=_NEARLY, most_simulations=most
        )
        rest = most - near.simulations
        found = descend(model, near.point, most_steps=_LAST_STEPS, most_simulations=rest)
        if is_precise:
            # the floor that stands for the noise of a computed position hides the bottom of the valley of DV, m and F_s
            sharp = replace(model, weight=model.weight * _SHARPER) if computed else model
            bottom = descend(sharp, found.point, most_steps=_FINE_STEPS, most_simulations=_MOST_FINE * most)
            budget.spend(model, bottom.simulations)
            found = replace(found, point=bottom.point, cost=model.cost(bottom.point))
        budget.spend(model, near.simulations + found.simulations)
        if math.isfinite(found.cost):
            ended.append(Place(found.point, found.cost))
    return distinct(model, ended)


def _on_telling_blocks(model: StemModel, places: list[Place], budget: Budget) -> list[Place]:
    """Descend first on blocks that tell what all rows tell at the best place, where these are many and uneven.

    Even rows are simulated from few closed forms, uneven ones each from its own.
    """
    if model.even_step > 0.0:
        return places
    fine = compressed(model, keeping=places[0].point)
    if _DEARER * fine.time_s.size > model.time_s.size:
        return places
    reached: list[Place] = []
    for place in places:
        if reached and place.cost > places[0].cost + 2.0 * NEAR:
            break
        most = budget.most_at_once(fine, _ON_ALL_ROWS)
        near = descend(
            fine, place.point, most_steps=_LAST_STEPS, one_sided=True, arrived=_NEARLY, most_simulations=most
        )
        found = descend(fine, near.point, most_steps=_LAST_STEPS, most_simulations=most - near.simulations)
        budget.spend(fine, near.simulations + found.simulations)
        reached.append(Place(found.point, found.cost) if math.isfinite(found.cost) else place)
    return distinct(fine, reached)


def certified(model: StemModel, point: FloatArray) -> Certificate:
    """Return the certificate of the fit at this point (p,)."""
    simulated_m = model.simulate(point)
    if simulated_m is None:
        return Certificate(math.inf, math.inf, 0)
    residual = (model.position_m - simulated_m) * model.weight
    return certify(residual, model.weight, bent_rows(simulated_m, model.weight))
