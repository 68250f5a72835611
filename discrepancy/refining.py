"""A fit followed further: other values of what a jagged cost hides, and walks along the bent valleys of slips."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from discrepancy.baseline import DYNAMIC, EXPLAINED, FIRST_RISES, LIMIT_MEDIAN, STATIC_SCAN, scanned
from discrepancy.least_squares import Fit, descend, on, start_fit
from discrepancy.walking import walked

# Own choices.
_BLUR_S: Final = 0.1
_REFINING_STEPS: Final = 15
_RESTARTED_SHARES: Final = (0.004, 0.03, 0.15)
_VISCOUS_FACTORS: Final = np.log([0.3, 0.7, 1.5, 3.0])
_OF_SLIPS: Final = frozenset({"m", "DV"})
_FAR: Final = math.log(2.0)  # twice or half the mass: nameplates are nearer
_MOST_WALKS: Final = 8
_WALK_STEPS: Final = 10
_WORTH_WALKING: Final = 0.99  # of the cost, that a walk must come to for another
_NOISE_ALONE: Final = 0.9  # of the cost of noise: nothing is left to win


def refined(fit: Fit) -> Fit:
    """Return the fit descended further, with other static frictions and dampings tried, as a jagged cost asks."""
    best = descend(fit, most_steps=_REFINING_STEPS)
    for name, factors in (("d", STATIC_SCAN), ("first_rise", FIRST_RISES), ("F_v", _VISCOUS_FACTORS)):
        best = scanned(best, name, factors)
    best = descend(best, most_steps=_REFINING_STEPS)
    for share in _RESTARTED_SHARES:
        if best.cost < EXPLAINED**2 * best.model.observed.count:
            break
        again = on(best.model.thinned(), _restarted(best, share))
        again = descend(again, most_steps=5, span_s=_BLUR_S, held=DYNAMIC)
        again = descend(on(best.model, scanned(again, "d", STATIC_SCAN)), most_steps=_REFINING_STEPS)
        best = again if again.cost < best.cost else best
    best = _along_valley(best, "DV")
    # a stem far from the nameplate's mass may stand in for a friction
    place = best.model.unknowns.names.index("m")
    is_far = abs(best.point[place] - best.model.unknowns.entries[place].prior) > _FAR
    return _along_valley(best, "m") if is_far else best


def _along_valley(fit: Fit, name: str) -> Fit:
    """Return the fit led down the valley along which DV or m stands in for damping and friction in a slip.

    The valley bends, and small steps end on its side: the unknown begins anew at what is usual, the others follow, and
    then it is free again, until that leads no lower twice. A mass moves all slips, so that blurred residuals go first.
    """
    place = fit.model.unknowns.names.index(name)

    def step(here: Fit) -> Fit:
        point = here.point.copy()
        point[place] = fit.model.unknowns.entries[place].prior
        held = start_fit(fit.model, point)
        if name == "m":
            held = descend(held, most_steps=_WALK_STEPS, span_s=_BLUR_S, held=_OF_SLIPS)
        held = descend(held, most_steps=_WALK_STEPS, held=frozenset({name}))
        return descend(held, most_steps=_REFINING_STEPS)

    return walked(fit, step, worth=_WORTH_WALKING, enough=_NOISE_ALONE, most_steps=_MOST_WALKS)


def _restarted(fit: Fit, viscous_share: float) -> Fit:
    """Return the fit with mass, damping and limit velocity as one would begin with, the friction in motion kept."""
    unknowns, values = fit.model.unknowns, dict(fit.values)
    priors = {entry.name: entry.value(entry.prior) for entry in unknowns.entries if entry.name in {"m", "DV"}}
    speed = priors["DV"] / LIMIT_MEDIAN
    friction_n = values["F_c"] + values["F_v"] * speed
    static_n = values["F_c"] * (1.0 + values["d"])
    coulomb_n = (1.0 - viscous_share) * friction_n
    values |= {
        **priors,
        "first_rise": 0.0,
        "F_v": viscous_share * friction_n / speed,
        "F_c": coulomb_n,
        "d": max(static_n / coulomb_n - 1.0, 0.0),
    }
    return start_fit(fit.model, unknowns.point(values))
