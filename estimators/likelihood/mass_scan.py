"""A fit that explains nothing is looked for at every mass: ringing that is sampled slower than it swings makes a comb.

Between two rows at 50 ms a stem that swings at 50 Hz goes round several times, so that the cost has a minimum at each
frequency that meets the rows alike, each as wide as the ringing's damping; a few masses as starts meet none of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np

from estimators.likelihood.arrival import led_to
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.hops import ratio_kept
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place, distinct
from estimators.likelihood.search import Found
from estimators.samples import FloatArray

# Own choices, from random valve 2485 (4.6 kg, 50 ms), whose search ended at 0.2 kg.
_MASSES_KG: Final = np.geomspace(0.1, 50.0, 60)  # of valves; a tenth from one to the next, a twentieth of a frequency
_DAMPINGS: Final = (0.02, 0.1, 0.4, 1.5)
_LIMITS: Final = (1.0e-3, 1.0e-2, 0.1)  # of the sliding speed
_MOST_VISCOUS: Final = 0.9  # of the friction in motion
_FEW_STEPS: Final = 4
_FEW: Final = 24
_STEPS: Final = 20
_LAST: Final = 4
_COARSE: Final = 0.3  # of the cost
_APART: Final = 0.1  # of a logarithm


def may_alias(spring_n_per_m: float, period_s: float) -> bool:
    """Whether the lightest stem on this spring would swing more than half a turn between two rows."""
    return period_s * math.sqrt(spring_n_per_m / float(_MASSES_KG[0])) > math.pi


def with_scanned_mass(found: Found, speed_m_per_s: float) -> Found:
    """Return the fit that the best of many masses, dampings and DV leads to, where that is lower; else ``found``.

    F_c + F_v v at the sliding speed ``speed_m_per_s`` and the force at breakaway stay as they are, and F_s = F_c is
    tried too.
    """
    small = compressed(found.model)
    starts = [Place(point, small.cost(point)) for point in _scanned(small, found.point, speed_m_per_s)]
    near = []
    for start in sorted(starts, key=lambda place: place.cost)[:_FEW]:
        if math.isfinite(start.cost):
            few = descend(small, start.point, most_steps=_FEW_STEPS, one_sided=True, arrived=_COARSE)
            near.append(Place(few.point, few.cost))
    ended = [
        descend(small, place.point, most_steps=_STEPS, one_sided=True, arrived=0.1 * _COARSE)
        for place in distinct(small, near, _APART)[:_LAST]
    ]
    best = min(ended, key=lambda one: one.cost, default=None)
    if best is None or best.cost >= small.cost(found.point):
        return found
    return led_to(found, best.point) or found


def _scanned(small: StemModel, point: FloatArray, speed_m_per_s: float) -> Iterator[FloatArray]:
    """Yield points (p,) at all masses, dampings and DV, with the friction in motion of this one."""
    here = small.coordinates.values(point)
    moving_n = here["F_c"] + here["F_v"] * speed_m_per_s
    for damping, limit, mass_kg, sharp in product(_DAMPINGS, _LIMITS, _MASSES_KG.tolist(), (False, True)):
        viscous = min(2.0 * damping * math.sqrt(here["k"] * mass_kg), _MOST_VISCOUS * moving_n / speed_m_per_s)
        values = here | {
            "m": mass_kg,
            "F_v": viscous,
            "F_c": moving_n - viscous * speed_m_per_s,
            "DV": limit * speed_m_per_s,
        }
        values["d"] = 0.0 if sharp else ratio_kept(here, values, here["k"] * speed_m_per_s)
        yield small.coordinates.point(values)
