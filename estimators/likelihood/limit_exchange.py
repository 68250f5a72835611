"""Another DV for a fit that explains too little: its first steps lead higher, so that no hop of a search keeps it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import EXACT, certified
from estimators.likelihood.arrival import arrived, led_to
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.search import Found

# Own choices, from random valves whose DV was 90 times too large.
_FACTORS: Final = (0.3, 0.03, 3.0)
_STEPS: Final = 15
_NEAR_SPEED: Final = 0.9
_LOWER: Final = 25.0  # of the cost


def with_other_limits(found: Found, slowest_n_per_s: float) -> Found:
    """Return the fit at the lowest place that another DV leads to; itself where it is good, or none is far lower.

    So it is where the other DV is near the speed of the ramp at ``slowest_n_per_s`` or above it: the stem goes in small
    jumps there, whose number makes a comb of minima, and one that explains the rows is seldom the right one.
    """
    if found.certificate.is_good or found.certificate.ratio < EXACT:
        return found
    begun, _ = arrived(found)
    model, number = begun.model, begun.model.coordinates.names.index("DV")
    small = compressed(model)
    lowest, lowest_cost = begun.point, small.cost(begun.point) - _LOWER
    for factor in _FACTORS:
        other = begun.point.copy()
        other[number] += math.log(factor)
        other = np.clip(other, model.coordinates.lower, model.coordinates.upper)
        ended = descend(small, other, most_steps=_STEPS, one_sided=True)
        if ended.cost < lowest_cost:
            lowest, lowest_cost = ended.point, ended.cost
    begun = replace(begun, certificate=certified(model, begun.point))
    led = None if lowest is begun.point else led_to(begun, lowest)
    led = begun if led is None else led
    values = model.coordinates.values(led.point)
    return found if values["DV"] * values["k"] > _NEAR_SPEED * slowest_n_per_s else led
