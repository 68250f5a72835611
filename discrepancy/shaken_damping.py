"""A shaken stem's damping: what a line tells of the force goes with it, and ramps of one rate do not tell it.

A plain valve with too little damping has a line of the right frequency and phase beside it, and too small a force. All
of it has to change at once: F_v, F_c so that the friction on the ramps stays, the force so that the stem answers it as
before, and F_s with the force where breakaways come at its crests. Between the two places single slips are let go or
not, and a descent, which changes one after the other, finds each step uphill.
"""

from __future__ import annotations

import cmath
import math
from itertools import product
from typing import Final

import numpy as np

from discrepancy.baseline import scanned
from discrepancy.causes.base import Cause, Values
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise, misfit

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_NEAR: Final = 2.0  # misfit, above which more than the damping is wrong
_FACTORS: Final = (1.2, 1.4)  # of the damping, either way
_CRESTS: Final = (0.7, 1.0, 1.3)  # of what the force gains, that static friction does
_STATIC_SCAN: Final = np.linspace(-0.03, 0.03, 13)
_BESIDE: Final = frozenset({"F_v"})
_BEGUN_STEPS: Final = 4
_STEPS: Final = 15
_FOLLOWED: Final = 2
_MOST_WORK: Final = 6.0e7  # passes


def with_other_damping(fit: Fit, cause: Cause) -> Fit:
    """Return the fit led to another damping, step by step, as far as that is lower; itself where noise is left."""
    last = fit.model.tally.work + _MOST_WORK
    sense: tuple[float, ...] = (1.0, -1.0)
    while misfit(fit) < _NEAR and not is_noise(fit):
        tried: list[tuple[Fit, float]] = []
        for factor, crest, way in product(_FACTORS, _CRESTS, sense):
            begun = _damped(fit, cause, factor**way, crest)
            if begun is not None and fit.model.tally.work < last:
                begun = scanned(begun, "d", _STATIC_SCAN)
                tried.append((descend(begun, most_steps=_BEGUN_STEPS, held=_BESIDE), way))
        tried.sort(key=lambda one: one[0].cost)
        found = [(descend(one, most_steps=_STEPS), way) for one, way in tried[:_FOLLOWED]]
        lowest, way = min(found, key=lambda one: one[0].cost, default=(fit, 0.0))
        if not (lowest.is_followed and lowest.cost < fit.cost):
            break
        fit, sense = lowest, (way,)
    return fit


def _damped(fit: Fit, cause: Cause, factor: float, crest: float) -> Fit | None:
    """Return the fit with another damping, its friction on the ramps and the stem's answer kept; None where none is."""
    values, strength, phase = fit.values, cause.own(cause.strength), cause.own("phase_rad")
    coulomb_n = values["F_c"] - (factor - 1.0) * values["F_v"] * setting_of(fit).sliding_m_per_s
    before, after = (_stiffness(values, cause, share) for share in (1.0, factor))
    force_n = values[strength] * abs(after) / abs(before)
    static_n = (1.0 + values["d"]) * values["F_c"] + crest * (force_n - values[strength])
    if not 0.0 < coulomb_n <= static_n:
        return None
    changed = {
        "F_v": factor * values["F_v"],
        "F_c": coulomb_n,
        "d": static_n / coulomb_n - 1.0,
        strength: force_n,
        phase: values[phase] + cmath.phase(after / before),
    }
    begun = start_fit(fit.model, fit.model.unknowns.point({**values, **changed}))
    return begun if begun.is_followed else None


def _stiffness(values: Values, cause: Cause, share: float) -> complex:
    """Force over answer of a sliding stem at the periodic force's frequency, N/m, with this share of the damping."""
    w = 2.0 * math.pi * values[cause.own("frequency_hz")]
    return complex(values["k"] - values["m"] * w * w, w * share * values["F_v"])
