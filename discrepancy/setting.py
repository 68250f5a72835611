"""The setting of a diagnosis: what a fit says of the valve's sizes, for the starts and sentences of causes."""

from __future__ import annotations

from typing import Final

import numpy as np

from discrepancy.causes.base import Setting
from discrepancy.least_squares import Fit
from valve.effects import ValveScale

_LEAST_FRICTION: Final = 1.0e-3  # of the full force: even a frictionless valve's effects have a size
_RAMPING: Final = 0.1


def setting_of(fit: Fit) -> Setting:
    """Return the setting that a fit gives."""
    observed, values = fit.model.observed, fit.values
    position_m = observed.position_m
    # the speed at which the force's ramps would lead the stem, also where it sticks and slips
    rates = np.concatenate([np.abs(motion.phases.force_rate) for motion in observed.motions])
    ramping = rates[rates > _RAMPING * float(np.quantile(rates, 0.95))]
    sliding = float(np.median(ramping)) / max(values["k"], 1.0e-3)
    scale = ValveScale(
        travel_m=observed.nameplate.actuator.travel_m,
        full_force_n=observed.full_force_n,
        # without the cause damping may stand in for most of F_c: what is felt in motion is the size
        friction_n=max(values["F_c"] + values["F_v"] * sliding, _LEAST_FRICTION * observed.full_force_n),
        spring_rate_n_per_m=max(values["k"], 1.0e-3),
    )
    return Setting(
        observed=observed,
        values=values,
        residual_m=fit.residual / observed.weight,
        scale=scale,
        low_m=float(position_m.min()),
        high_m=float(position_m.max()),
        sliding_m_per_s=sliding,
    )
