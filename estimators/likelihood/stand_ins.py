"""Values that only stand in for others that the test does not show: they are not given."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Final

from estimators.base import ParameterEstimate, absent
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.intervals import Ramps
from estimators.likelihood.model import StemModel
from estimators.samples import FloatArray

_LIMIT_ALONE: Final = (
    "below DV the stem is accelerated undamped, above it F_v damps it: where neither m nor F_v shows, a DV near the "
    "speed of the ramps only stands in for them"
)
_MAY_CREEP: Final = (
    "the stem may have crept below DV, where F_s alone is felt, and only what valves usually are speaks against that: "
    "repeat with a faster ramp"
)
_LIMITS: Final = (1.05, 1.4)  # of the slowest ramp's speed
_VISCOUS_SHARES: Final = (0.2, 0.5)  # of the friction in motion
_USUAL_KG: Final = 3.0
_MOST_EVENTS: Final = 12_000  # of small jumps
_STEPS: Final = 10
_SHOWN: Final = 3.84  # of the cost: one value in twenty is as far off by chance


def without_lone_limit(parameters: dict[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """Return the parameters without a DV that only stands in for m and F_v, of which neither shows."""
    if parameters["m"].identifiable or parameters["F_v"].identifiable or not parameters["DV"].identifiable:
        return parameters
    return parameters | {"DV": absent(_LIMIT_ALONE)}


def without_lone_coulomb(
    parameters: dict[str, ParameterEstimate], model: StemModel, point: FloatArray, ramps: Ramps, noise_factor: float
) -> dict[str, ParameterEstimate]:
    """Return the parameters without an F_c that may be F_s: of a stem that shows neither F_v nor DV at one speed."""
    asked = parameters["F_c"].identifiable and len(ramps.rates_n_per_s) == 1
    if not asked or parameters["F_v"].identifiable or parameters["DV"].identifiable:
        return parameters
    is_open = may_creep(model, point, ramps.rates_n_per_s[0], noise_factor)
    return parameters | {"F_c": absent(_MAY_CREEP)} if is_open else parameters


def may_creep(model: StemModel, point: FloatArray, rate_n_per_s: float, noise_factor: float) -> bool:
    """Whether a stem slower than DV explains the rows as well as the fit at ``point`` (p,), beliefs about DV aside.

    It feels F_s in motion, so that F_s is what F_c + F_v v was, at the speed v of a ramp with this rate of the force.
    """
    small = compressed(replace(model, most_events=max(model.most_events, _MOST_EVENTS)))
    values = model.coordinates.values(point)
    speed = rate_n_per_s / values["k"]
    friction_n = values["F_c"] + values["F_v"] * speed
    least = _without_belief(small, point, small.cost(point)) + _SHOWN * noise_factor**2
    for limit, share in product(_LIMITS, _VISCOUS_SHARES):
        coulomb_n = (1.0 - share) * friction_n
        rival = {
            "m": _USUAL_KG,
            "DV": limit * speed,
            "F_v": share * friction_n / speed,
            "F_c": coulomb_n,
            "d": friction_n / coulomb_n - 1.0,
        }
        start = model.coordinates.point(values | rival)
        found = descend(small, start, most_steps=_STEPS, held=("DV",), one_sided=True)
        if math.isfinite(found.cost) and _without_belief(small, found.point, found.cost) < least:
            return True
    return False


def _without_belief(model: StemModel, point: FloatArray, cost: float) -> float:
    """The cost without what is believed of DV beforehand."""
    own = model.coordinates
    number = own.names.index("DV")
    return cost - float(own.prior_weight[number] * (point[number] - own.prior[number]) ** 2)
