"""From jumps that begin anew at their rests to the whole motion: the stem goes on unhelped farther and farther.

A jump begins where the one before ended, so that a small error of the valve adds up over hundreds of jumps: beyond some
of them the simulated ones are beside the measured ones, and the cost tells nothing. What a few jumps tell is enough for
half as many more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.bent_valley import descend_bent
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed, without_outliers
from estimators.likelihood.descent import descend
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place
from estimators.samples import FloatArray

# Own choices, from random valves that stick and slip.
_FIRST_RESTS: Final = 12
_GROWTH: Final = 1.5  # of the rests passed, from one horizon to the next
_SHORTER: Final = 4  # times half as far on, where the motion falls out of step
_STEPS: Final = 8
_BENT_SIMULATIONS: Final = 100
_ARRIVED: Final = 0.3  # of the cost
_LEVEL: Final = 1.0  # of the cost: along the bent valley
_IN_STEP: Final = 3.0  # mean square of the residuals over the noise's: a jump beside its place leaves hundreds
_AS_BEFORE: Final = 1.5  # times that of the horizon before: what the model misses, it misses farther on too


def led_on(model: StemModel, small: StemModel, rests: Restarts, place: Place, budget: Budget) -> Place:
    """Return where this place leads as the simulated stem passes more and more of the rests without beginning anew.

    ``small`` is the whole motion. Where a longer motion falls out of step a shorter one is tried first. It ends early,
    at the last place, where the budget does.
    """
    point, passed, strides, limit = place.point, 0, 0, _IN_STEP
    ahead = _FIRST_RESTS
    while budget.left > 0.0:
        is_whole = ahead >= rests.row.size
        reached = _reached(small if is_whole else _beginning_anew(model, rests, ahead), point, limit, budget)
        if reached.misfit > limit and strides < _SHORTER and ahead > passed + 1:
            strides += 1
            ahead = (passed + ahead) // 2 if not is_whole else (passed + rests.row.size) // 2
            continue
        point, limit = reached.point, max(_IN_STEP, _AS_BEFORE * reached.misfit)
        if is_whole:
            break
        grown = max(ahead + 1, int(_GROWTH * ahead))
        # as far on as was in step last, and farther again then
        ahead, passed, strides = grown if strides == 0 else 2 * ahead - passed, ahead, max(strides - 1, 0)
    return Place(point, small.cost(point))


@dataclass(frozen=True, slots=True, eq=False)
class _Reached:
    point: FloatArray
    misfit: float  # mean square of the residuals up to the horizon, over the noise's


def _reached(own: StemModel, point: FloatArray, limit: float, budget: Budget) -> _Reached:
    """Descend with this horizon, along the bent valley too where the motion is out of step."""
    clean = _without_outlying_parts(own, point)
    found = descend(clean, point, most_steps=_STEPS, one_sided=True, arrived=_ARRIVED)
    budget.spend(own, found.simulations)
    misfit = _misfit(own, found.point)
    if misfit > limit:
        found = descend_bent(clean, found.point, most_simulations=_BENT_SIMULATIONS, arrived=_LEVEL)
        budget.spend(own, found.simulations)
        misfit = _misfit(own, found.point)
    return _Reached(found.point, misfit)


def _beginning_anew(model: StemModel, rests: Restarts, passed: int) -> StemModel:
    """Return the model, of blocks, whose stem passes so many rests and begins anew at each one after them."""
    return compressed(replace(model, restarts=Restarts(rests.row[passed:], rests.position_m[passed:])))


def _horizon(model: StemModel) -> int:
    return model.time_s.size if model.restarts is None else int(model.restarts.row[0])


def _without_outlying_parts(model: StemModel, point: FloatArray) -> StemModel:
    """Return the model without the parts beyond the horizon that are far worse than most at this point (p,)."""
    horizon = _horizon(model)
    weight = np.concatenate([model.weight[:horizon], without_outliers(model, point).weight[horizon:]])
    return replace(model, weight=weight)


def _misfit(model: StemModel, point: FloatArray) -> float:
    residual = model.residuals(point)
    if residual is None:
        return float("inf")
    own = residual[: _horizon(model)]
    return float(own @ own) / max(1, int(np.count_nonzero(model.weight[: own.size])))
