"""Method 1's second step, the limit velocity DV (Romano & Garcia 2007, Eq. 8), and why it is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.classic.threshold_sweep import ThresholdSweep
from valve.messages import say

_CLOSE_TO_ZERO: Final = 1.0e-3  # of F_c: what Eq. (8) calls close to zero
_TIED: Final = say("limit_velocity_tied", "on ramps of one speed DV cannot be told from F_s")
_NONE: Final = say("limit_velocity_none", "Eq. (8) finds none; {why}", why=_TIED)


@dataclass(frozen=True, slots=True)
class LimitVelocity:
    """What Eq. (8) gives: the threshold and its number s, or None; and the note that says what it is worth."""

    value_m_per_s: float | None
    threshold: int | None
    note: str


def limit_velocity(
    sweep: ThresholdSweep, coulomb_n: float | None, viscous_n_s_per_m: float | None, speed: float
) -> LimitVelocity:
    """Least threshold at which the friction of its fit is that of the final one, by Eq. (8).

    F_cs and F_vs are the sweep's (its third coefficient is F_c + F_v ``speed``); its error is close to zero where
    it is below 0.1 % of F_c. The grid is coarser than DV wherever the stem slips, so that what is found is where
    backward differences begin to hold.
    """
    if coulomb_n is None or viscous_n_s_per_m is None:
        return LimitVelocity(None, None, _NONE)
    limits = sweep.thresholds_m_per_s
    viscous = sweep.coefficients[:, 1]
    coulomb = sweep.coefficients[:, 2] - viscous * speed
    error = np.abs((coulomb - coulomb_n) + (viscous - viscous_n_s_per_m) * limits)
    close = np.flatnonzero((error <= _CLOSE_TO_ZERO * abs(coulomb_n)) & np.isfinite(sweep.std_error[:, 0]))
    if close.size == 0:
        return LimitVelocity(None, None, _NONE)
    found = float(limits[close[0]])
    note = say(
        "limit_velocity_on_grid",
        "Eq. (8) gives {found:.3g m/s} on a grid of {step:.2g m/s}, which is where differences "
        "begin to hold and not where the stem comes to rest; {why}",
        found=found,
        step=float(sweep.step_m_per_s),
        why=_TIED,
    )
    return LimitVelocity(found, int(close[0]) + 1, note)
