"""The errors of the measured input as unknowns of the fit: the position tells of the force's lines too."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import certified
from estimators.likelihood.budget import Budget
from estimators.likelihood.certificate import LARGEST_RATIO
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates, linear
from estimators.likelihood.elimination import descend_with_errors, eliminated, spread_of
from estimators.likelihood.hopping import Hopping, hopped
from estimators.likelihood.model import Corners, StemModel
from estimators.likelihood.pool import Place, chosen_trials, distinct, halved, ranked
from estimators.likelihood.problem import Problem
from estimators.likelihood.search import Found, searched_again, stages_of
from estimators.likelihood.thinned_force import thinned
from estimators.samples import FloatArray

PREFIX: Final = "input_"
# Own choices: directions whose one sigma moves all positions together by less do not matter; the most that are fitted.
_LEAST_EFFECT: Final = 0.05
_MOST: Final = 100
_STEP_SHARE: Final = 0.05  # of the range, within one period: steeper than any ramp
_RANKING_SHARE: Final = 0.2  # of the budget
_REFILL: Final = 0.35  # of the budget, for the hops from each place
_MOST_HOPPED: Final = 4  # places
_STEPS: Final = 12
_LAST_STEPS: Final = 3
_LAST_ROUNDS: Final = 2
_MOST_ROUNDS: Final = 3
_WORTH_A_DESCENT: Final = 1.0  # of the cost


def with_input_errors(model: StemModel, point: FloatArray, changed: Iterable[Corners]) -> StemModel:
    """Return the model with an unknown input_1, ... of standard deviation 1 for each direction that matters.

    ``changed`` are corners changed by one sigma along each independent direction, at the nuisances of ``point`` (p,).
    """
    time_s, force_n = model.corners(model.coordinates.values(point))
    small = compressed(model)
    here = small.simulate(point)
    if here is None:
        return model
    sized: list[tuple[float, Corners]] = []
    for other_s, other_n in changed:
        if other_s.shape != time_s.shape:
            continue
        step = (other_s - time_s, other_n - force_n)
        moved = replace(small, path=_Moved((other_s, other_n))).simulate(point)
        effect = float("inf") if moved is None else float(np.linalg.norm((moved - here) * small.weight))
        if effect > _LEAST_EFFECT:
            sized.append((effect, step))
    sized.sort(key=lambda pair: -pair[0])
    deviations = tuple(step for _, step in sized[:_MOST])
    more = [linear(f"{PREFIX}{number}", 1.0, sd=1.0) for number in range(1, len(deviations) + 1)]
    return replace(model, deviations=deviations, coordinates=Coordinates((*model.coordinates.entries, *more)))


def whitened(model: StemModel, widened: StemModel, point: FloatArray) -> StemModel:
    """Return the model on blocks with the input's errors, which ``widened`` has as unknowns, eliminated linearly.

    Errors D e, e of unit variance, beside white noise have the covariance I + D D^T. D is taken at ``point`` (p,).
    """
    return _eliminated(compressed(model), widened, point)


def searched_anew(model: StemModel, widened: StemModel, found: Found, hopping: Hopping, problem: Problem) -> FloatArray:
    """Return the lowest point (p,) on blocks with the input's errors eliminated linearly; hops from the best places.

    Where the fit without these errors does not explain the recording, they have decided which place was the lowest,
    and m, F_v and DV stand in for them: then all trial values are followed once more.
    """
    values = model.coordinates.values(found.point)
    model, widened = thinned(model, values), thinned(widened, values | _no_errors(widened))
    small = whitened(model, widened, found.point)
    if found.certificate.is_good or hopping.jumps:
        return searched_again(small, found, hopping)
    stages = [_eliminated(stage, widened, found.point) for stage in stages_of(model, problem.rests, jumps=False)]
    budget = Budget.of(model)
    most = budget.most_simulations(stages[0], _RANKING_SHARE)
    first = ranked(stages[0], chosen_trials(problem.trials, most), budget)
    places = halved([*stages, small], first, budget)
    known = [Place(point, small.cost(point)) for point in (found.point, *(place.point for place in found.others))]
    places = distinct(small, [*places, *known])
    whole, best = budget.whole, places[0]
    for place in places[:_MOST_HOPPED]:
        budget.left = max(budget.left, _REFILL * whole)
        best = min(best, *hopped(small, [place], hopping, budget, whole), key=lambda one: one.cost)
        if best.cost < LARGEST_RATIO**2 * small.time_s.size:
            break
    return best.point


def _no_errors(widened: StemModel) -> dict[str, float]:
    return {f"{PREFIX}{number}": 0.0 for number in range(1, len(widened.deviations) + 1)}


def _eliminated(small: StemModel, widened: StemModel, point: FloatArray) -> StemModel:
    """Return this model of blocks with the errors that ``widened`` has as unknowns eliminated linearly."""
    here = small.simulate(point)
    corner_s, force_n = small.corners(small.coordinates.values(point))
    columns: list[FloatArray] = []
    for late_s, more_n in widened.deviations:
        moved = replace(small, path=_Moved((corner_s + late_s, force_n + more_n))).simulate(point)
        if here is not None and moved is not None:
            columns.append((moved - here) * small.weight)
    if not columns:
        return small
    return replace(small, spread=spread_of(np.stack(columns, axis=1)))


def step_instants(corners: Corners, period_s: float) -> Iterator[Corners]:
    """Corners with each step of the force later by a period / sqrt(12): it lies anywhere between two samples."""
    time_s, force_n = corners
    least_n = _STEP_SHARE * float(np.ptp(force_n))
    is_step = (np.diff(time_s) <= 1.01 * period_s) & (np.abs(np.diff(force_n)) > least_n)
    for first in np.flatnonzero(is_step)[:_MOST]:
        moved_s = time_s.copy()
        moved_s[first : first + 2] += period_s / np.sqrt(12.0)
        yield moved_s, force_n


def refit(model: StemModel, found: Found, point: FloatArray) -> Found:
    """Descend again with the input's errors as unknowns: from ``found`` and ``point`` (p,) on blocks, then on all rows.

    ``point`` is where the errors, eliminated linearly, lead to. On all rows it goes on from the lowest of these, or
    from ``found`` itself where that is lower.
    """
    none = np.zeros(len(model.deviations))
    small = compressed(model)
    nears = [
        descend_with_errors(small, np.concatenate([start, none]), most_steps=_STEPS, one_sided=True)
        for start in ([found.point] if np.array_equal(point, found.point) else [found.point, point])
    ]
    # blocks may lead away from what explains all rows already
    begun = [np.concatenate([found.point, none]), *(near.point for near in nears)]
    again = descend_with_errors(
        model, min(begun, key=model.cost), most_steps=_LAST_STEPS, rounds=_LAST_ROUNDS, one_sided=True
    )
    if not math.isfinite(again.cost):
        return found
    return replace(
        found,
        model=model,
        point=again.point,
        cost=again.cost,
        certificate=certified(model, again.point),
        others=tuple(
            Place(np.concatenate([place.point, again.point[found.point.size :]]), place.cost - found.cost + again.cost)
            for place in found.others
        ),
        simulations=found.simulations + sum(one.simulations for one in nears) + again.simulations,
    )


def hopped_anew(found: Found, hopping: Hopping) -> Found:
    """Return the fit with the input's errors after hops with these eliminated about it, again until none is lower.

    Errors that were eliminated about another place, on blocks chosen without them, may have led to a wrong place; the
    blocks tell now what all rows tell at the fit, and the errors are those that were found.
    """
    model = found.model
    for _ in range(_MOST_ROUNDS):
        fine = compressed(model, keeping=found.point)
        near = eliminated(fine, found.point)
        if near is None:
            break
        small, own = near.model, found.point[: near.count]
        budget = Budget.of(model)
        budget.left *= _REFILL
        places = hopped(small, [Place(own, small.cost(own))], hopping, budget, budget.left)
        simulations = found.simulations + budget.simulations
        if places[0].cost > small.cost(own) - _WORTH_A_DESCENT:
            return replace(found, simulations=simulations)
        lower = descend_with_errors(fine, near.with_errors(places[0].point), most_steps=_STEPS, one_sided=True)
        again = descend_with_errors(model, lower.point, most_steps=_LAST_STEPS, rounds=_LAST_ROUNDS, one_sided=True)
        simulations += lower.simulations + again.simulations
        if again.cost > found.cost - _WORTH_A_DESCENT:
            return replace(found, simulations=simulations)
        certificate = certified(model, again.point)
        found = replace(found, point=again.point, cost=again.cost, certificate=certificate, simulations=simulations)
    return found


class _Moved:
    """Corners as they are given, whatever the nuisances."""

    def __init__(self, corners: Corners) -> None:
        self._corners = corners

    def corners(self, _values: FloatArray) -> Corners:
        return self._corners
