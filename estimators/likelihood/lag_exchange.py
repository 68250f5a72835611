"""Of a command alone: the I/P's lag and F_v/k of the stem in each other's place, tried at every share of their sum."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Final

from estimators.likelihood.all_rows import NEAR
from estimators.likelihood.arrival import led_to
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.inputs.transducer_path import LAG
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place, distinct
from estimators.likelihood.search import Found
from estimators.samples import FloatArray

# Own choices, from random valves of which a wrong place was 200 to 300 above the truth (2481, 2483).
_SHARES: Final = (0.02, 0.97, 0.5, 0.2, 0.8, 0.35, 0.65, 0.9)  # of lag + F_v/k
_RATIOS: Final = (0.02, 0.1, 0.4)  # F_s/F_c - 1, beside the own
_HELD_STEPS: Final = 4
_STEPS: Final = 25
_COARSE: Final = 0.3  # of the cost
_FOLLOWED: Final = 8  # places, each of another share
_LOWER: Final = 1.0  # of the cost
_BUDGET_SHARE: Final = 0.5
_ROUNDS: Final = 2


def with_other_lags(found: Found) -> Found:
    """Return the fit at the lowest place that another share of lag + F_v/k leads to, with those nearly as low.

    Both are lags in series, which may change places but for friction: between two such places the cost rises by
    thousands, so that no walk passes from one to the other. Without a lag among the unknowns it is ``found`` itself.
    """
    if LAG not in found.model.coordinates.names:
        return found
    for _ in range(_ROUNDS):
        small = compressed(found.model, keeping=found.point)
        here = small.cost(found.point)
        places = _followed(small, found.point, Budget.limited(_BUDGET_SHARE * Budget.of(found.model).whole))
        led = led_to(found, places[0].point) if places and places[0].cost < here - _LOWER else None
        lowest = min(here, places[0].cost) if places else here
        near = [Place(place.point, found.model.cost(place.point)) for place in places if place.cost < lowest + NEAR]
        found = found if led is None else led
        kept = distinct(found.model, [Place(found.point, found.cost), *found.others, *near])
        others = tuple(place for place in kept[1:] if place.cost < found.cost + NEAR)
        found = replace(found, others=others)
        if led is None:
            break
    return found


def _followed(small: StemModel, point: FloatArray, budget: Budget) -> list[Place]:
    """Descend from each share with the lag held, then from the lowest of these with all free; cheapest first."""
    coarse: dict[float, Place] = {}
    for share, start in _exchanged(small, point):
        if budget.left < 0.0:
            break
        near = descend(small, start, most_steps=_HELD_STEPS, held=(LAG,), arrived=_COARSE, one_sided=True)
        budget.spend(small, near.simulations)
        if math.isfinite(near.cost) and (share not in coarse or near.cost < coarse[share].cost):
            coarse[share] = Place(near.point, near.cost)
    ended = []
    for place in distinct(small, list(coarse.values()))[:_FOLLOWED]:
        free = descend(small, place.point, most_steps=_STEPS, arrived=0.1 * _COARSE, one_sided=True)
        ended.append(Place(free.point, free.cost))
    return distinct(small, ended)


def _exchanged(small: StemModel, point: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Yield shares of the lag, and points (p,) with the same lag + F_v/k in those shares, and other F_s/F_c."""
    here = small.coordinates.values(point)
    both_s = here[LAG] + here["F_v"] / here["k"]
    for ratio, share in product((here["d"], *_RATIOS), _SHARES):
        changed = {LAG: share * both_s, "F_v": (1.0 - share) * both_s * here["k"], "d": ratio}
        yield share, small.coordinates.point(here | changed)
