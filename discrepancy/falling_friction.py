"""The way to the fit of a friction that falls with speed: its cost has a narrow, bent valley.

The Stribeck speed v_s, F_c, F_v and F_s go together: friction at the speeds that occur is known well, and which law it
follows much worse. Steps of all unknowns leave such a valley; steps of v_s beside the same friction follow it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from discrepancy.causes.base import Values
from discrepancy.causes.friction import STRIBECK
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.setting import setting_of

SPEED: Final = STRIBECK.own(STRIBECK.strength)
# Own choices.
_FACTORS: Final = (1.15, 1.0 / 1.15, 1.04, 1.0 / 1.04)  # of v_s: first the wide valley, then its bottom
_MISSES: Final = 2  # steps that come no lower, in a row, after which a walk ends
_STEPS: Final = 6
_SPEEDS: Final = 41
_SLOWEST: Final = 1.0e-3  # of the fastest
_RAMPS: Final = 3.0  # times their speed: the stem is as fast as that when it breaks away


def along_valley(fit: Fit) -> Fit:
    """Return the lowest fit on walks along v_s, each step beginning with the friction that the last one had."""
    fastest = _fastest(fit)
    for factor in _FACTORS:
        fit = _walked(fit, factor, fastest)
    return fit


def _fastest(fit: Fit) -> float:
    reached = max(float(np.abs(motion.phases.velocity).max()) for motion in fit.model.observed.motions)
    return max(reached, _RAMPS * setting_of(fit).sliding_m_per_s)


def _walked(fit: Fit, factor: float, fastest: float) -> Fit:
    best, here, misses = fit, fit, 0
    while misses < _MISSES:
        values = _same_friction(here.values, here.values[SPEED] * factor, fastest)
        if values is None:
            break
        here = descend(
            start_fit(fit.model, fit.model.unknowns.point(values)), most_steps=_STEPS, held=frozenset({SPEED})
        )
        if not here.is_followed:
            break
        if here.cost < best.cost:
            best, misses = here, 0
        else:
            misses += 1
    return best


def _same_friction(values: Values, speed: float, fastest: float) -> Values | None:
    """Return the values with another v_s and the F_c and F_v that leave the friction up to ``fastest`` nearest.

    F_s stays. None where they are no valve's.
    """
    at = np.geomspace(_SLOWEST * fastest, fastest, _SPEEDS)
    static_n = values["F_c"] * (1.0 + values["d"])
    fallen = 1.0 - np.exp(-((at / values[SPEED]) ** 2))
    friction_n = static_n + (values["F_c"] - static_n) * fallen + values["F_v"] * at
    share = 1.0 - np.exp(-((at / speed) ** 2))
    solved = np.linalg.lstsq(np.column_stack([share, at]), friction_n - static_n * (1.0 - share), rcond=None)[0]
    coulomb_n, viscous = float(solved[0]), float(solved[1])
    if not (0.0 < coulomb_n <= static_n and viscous > 0.0):
        return None
    return {**values, SPEED: speed, "F_c": coulomb_n, "F_v": viscous, "d": static_n / coulomb_n - 1.0}
