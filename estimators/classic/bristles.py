"""Where a stem that yields before it breaks away is given up by its bristles: later than where it leaves its rest."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.classic.force_windows import Leaving
from estimators.engine.force_path import turns
from estimators.engine.segmentation import moving_mean
from estimators.engine.yielding import Driven, Held, gave_way, yielding
from estimators.samples import Samples

_SMOOTHED_S: Final = 0.02  # of the force: a gauge's noise is not the most that bristles bear
_INSTANT_S: Final = 5.0e-3  # of the instant, as the force is smoothed


def leaving_of_bristles(samples: Samples, held: Held) -> Leaving | None:
    """Return where the bristles give way; None of a stem that surely does not yield, or too little."""
    time_s, range_n = samples.time_s, float(np.ptp(samples.force_n))
    force_n = moving_mean(samples.force_n, 2 * (max(1, round(_SMOOTHED_S / samples.period_s)) // 2) + 1)
    turns_s = turns(time_s, samples.force_n, samples.force_noise_n, range_n)
    driven = Driven(time_s, samples.position_m, force_n, turns_s, samples.position_noise_m)
    soft = yielding(driven, held)
    if soft is None:
        return None
    found = gave_way(driven, held, soft.value)
    if found.time_s.size == 0:
        return None
    return Leaving(
        force_n=found.force_n,
        rate=found.rate_n_per_s,
        position_m=found.travel_m,
        sense=found.direction,
        time_s=found.time_s,
        within_s=np.full(found.time_s.size, _INSTANT_S),
        stroke=np.arange(found.time_s.size),
    )
