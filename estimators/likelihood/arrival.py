"""Whether a fit ended at the bottom: what Gauss and Newton's step from there would still take off the cost."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import EXACT, certified
from estimators.likelihood.bent_valley import usual_rate
from estimators.likelihood.budget import Budget
from estimators.likelihood.descent import descend
from estimators.likelihood.elimination import FEW_ERRORS, descend_with_errors, eliminated
from estimators.likelihood.hopping import led_along_jumps
from estimators.likelihood.model import STEP
from estimators.likelihood.pool import Place, distinct
from estimators.likelihood.search import Found
from estimators.likelihood.valley_of_jumps import FOR_JUMPS, is_charted
from estimators.samples import FloatArray

# A bottom is left by less than two standard errors in all; a narrow, bent valley of m, F_v, F_c and DV by far more.
_LARGEST_GAIN: Final = 4.0
_FURTHER_STEPS: Final = 30
_ROUNDS: Final = 4  # in which many errors of the input are found anew
_FURTHER_SHARE: Final = 0.3  # of the budget
_LOWER: Final = 1.0  # of the cost
# steps of differences that smooth what many hidden jumps make of the cost; the last is worth a second descent
_COARSER: Final = (1.0e-4, 1.0e-3, 1.0e-3)
_SMALLEST_SHARE: Final = 1.0e-12  # of the largest eigenvalue: below it a direction is not seen at all


def left_to_gain(found: Found, difference: float = STEP) -> float:
    """Fall of the cost that the full step promises, all unknowns but those at a bound free.

    The intervals are those of the parabola about the point; where the step promises much, the point is not its bottom
    and they say nothing. ``difference`` is the step of the derivatives' differences.
    """
    model, point = found.model, found.point
    residual, slopes = model.residuals(point), model.slopes(point, steps=np.full(point.size, difference))
    if residual is None or slopes is None:
        return float("inf")
    weight = model.coordinates.prior_weight
    normal = slopes @ slopes.T + np.diag(weight)
    pull = slopes @ residual - weight * (point - model.coordinates.prior)
    inside = (model.coordinates.lower < point) & (point < model.coordinates.upper) & (np.diag(normal) > 0.0)
    scale = np.sqrt(np.diag(normal)[inside])
    matrix: FloatArray = normal[np.ix_(inside, inside)] / np.outer(scale, scale)
    own: FloatArray = pull[inside] / scale
    solution = np.linalg.lstsq(matrix, own, rcond=_SMALLEST_SHARE)[0]
    return float(solution @ own)


def arrived(found: Found, *, jumps: bool = False) -> tuple[Found, bool]:
    """Return the fit, led further where it had not arrived, and whether it is at the bottom now.

    Each jump that a change of the unknowns adds makes a kink of the cost: where finer differences see nothing but
    kinks, coarser ones lead on and judge. Many errors of the input go where they go best with the others. A stem
    that jumps on the ramps is led along its valley before; one that creeps only if it is known to: ``jumps``.
    """
    if found.certificate.ratio < EXACT:
        return found, True
    if len(found.model.deviations) <= FEW_ERRORS:
        return _led_further(found, jumps=jumps)
    for _ in range(_ROUNDS):
        near = eliminated(found.model, found.point)
        if near is None:
            return found, False
        own = found.point[: near.count]
        led, is_bottom = _led_further(replace(found, model=near.model, point=own, cost=near.model.cost(own)))
        point = near.with_errors(led.point)
        gain, promised = found.cost - found.model.cost(point), found.cost - led.cost
        if gain > 0.0:
            found = replace(found, point=point, cost=found.cost - gain, simulations=led.simulations)
        if promised < _LARGEST_GAIN:
            return found, is_bottom
        if gain < 0.5 * promised:
            break
    return _led_further(found)


def _led_further(found: Found, *, jumps: bool = False) -> tuple[Found, bool]:
    """Return the fit where descents of coarser and coarser differences lead to, and whether that is the bottom."""
    if left_to_gain(found) < _LARGEST_GAIN:
        return found, True
    found = _led_along_jumps(found, jumps=jumps)
    most = Budget.of(found.model).most_at_once(found.model, _FURTHER_SHARE)
    for difference in (STEP, *_COARSER):
        further = descend(
            found.model, found.point, most_steps=_FURTHER_STEPS, most_simulations=most, difference=difference
        )
        if further.cost < found.cost:
            simulations = found.simulations + further.simulations
            found = replace(found, point=further.point, cost=further.cost, simulations=simulations)
        if left_to_gain(found, difference) < _LARGEST_GAIN:
            return found, True
    return found, left_to_gain(found) < _LARGEST_GAIN


def _led_along_jumps(found: Found, *, jumps: bool) -> Found:
    """Return the fit led down the valley of jumps on all rows: blocks of them have sills of their own.

    The small jumps of a stem that is slower than DV make a comb of minima, of which it would come to another one.
    """
    if found.model.deviations or not is_charted(found.model, found.point):
        return found
    values = found.model.coordinates.values(found.point)
    if not jumps and values["DV"] * values["k"] > usual_rate(*found.model.corners(values)):
        return found
    budget = Budget.limited(FOR_JUMPS)
    led = led_along_jumps(found.model, Place(found.point, found.cost), budget, 0.0)
    return replace(found, point=led.point, cost=led.cost, simulations=found.simulations + budget.simulations)


def led_to(found: Found, point: FloatArray, *, jumps: bool = False) -> Found | None:
    """Return the fit at the bottom that ``point`` (p,) leads to, with the old one beside it; None if it is no lower."""
    model = found.model
    most = Budget.of(model).most_at_once(model, _FURTHER_SHARE)
    further = descend_with_errors(model, point, most_steps=_FURTHER_STEPS, most_simulations=most)
    simulations = found.simulations + further.simulations
    led = replace(found, point=further.point, cost=further.cost, simulations=simulations)
    led = _led_along_jumps(led, jumps=jumps)
    if not led.cost < found.cost - _LOWER:
        return None
    best = Place(led.point, led.cost)
    return replace(
        led,
        certificate=certified(model, led.point),
        others=tuple(distinct(model, [best, Place(found.point, found.cost), *found.others])[1:]),
    )
