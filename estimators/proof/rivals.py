"""Other valves that may move as one that was found: where one speed of the ramps leaves F_v, F_c and DV ambiguous."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.motion.phases import After
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.proof import Proof
from estimators.proof.whole_motion import SYMBOLS
from estimators.samples import FloatArray

# Own choices, from graphite-packed and frictionless valves at 5 to 50 ms.
_HEAVILY: Final = 2.0  # damping ratio
_SLIDES: Final = 0.5  # of F_s - A: from this share of F_v v on the stem may slide at DV, where it is damped so heavily:
_SLIDING: Final = ((0.5, 1.5), (0.9, 2.5))  # DV by the slowest ramp's speed, F_v by what was found
_POORLY: Final = 0.1  # standard error of ln F_v
_SHARES: Final = (0.05, 0.2, 0.5)  # of the friction in motion that may be F_v v
_SEVERAL: Final = 1.3

_M, _K, _F_V, _F_C, _F_S, _DV = (SYMBOLS.index(symbol) for symbol in ("m", "k", "F_v", "F_c", "F_s", "DV"))


def rivals(proof: Proof, motion: RecordedMotion) -> list[FloatArray]:
    """Return values (7,) to be tried beside those of the proof, all with the same friction in motion, F_c + F_v v."""
    values = proof.place.values
    speeds = _ramp_speeds(motion, float(values[_K]))
    if speeds.size == 0:
        return []
    slowest, usual = float(speeds.min()), float(np.median(speeds))
    friction = float(values[_F_C] + values[_F_V] * usual)
    jump = max(0.0, float(values[_F_S]) - friction)
    found = []
    damped = float(values[_F_V]) ** 2 > _HEAVILY**2 * 4.0 * float(values[_M] * values[_K])
    if damped and float(values[_F_V]) * usual > _SLIDES * jump:
        for share, factor in _SLIDING:
            viscous = min(factor * float(values[_F_V]), 0.95 * friction / usual)
            found.append(_with(values, friction, usual, viscous=viscous, limit=share * slowest))
    one_speed = float(speeds.max()) < _SEVERAL * slowest
    if one_speed and float(proof.std_error[_F_V]) > _POORLY * float(values[_F_V]):
        found += [_with(values, friction, usual, viscous=share * friction / usual) for share in _SHARES]
    return found


def _with(
    values: FloatArray, friction: float, speed: float, *, viscous: float, limit: float | None = None
) -> FloatArray:
    """The values with this F_v, the F_c that leaves A, and this DV."""
    changed = values.copy()
    changed[_F_V] = viscous
    changed[_F_C] = max(0.0, friction - viscous * speed)
    changed[_F_S] = max(float(values[_F_S]), float(changed[_F_C]))
    if limit is not None:
        changed[_DV] = limit
    return changed


def _ramp_speeds(motion: RecordedMotion, spring_n_per_m: float) -> FloatArray:
    """Speed of the ramp of each driven stretch, m/s."""
    phases = motion.phases
    rows = [
        (stretch.first + stretch.last) // 2
        for stretch in phases.stretches
        if stretch.driven and stretch.after is not After.UNKNOWN
    ]
    speeds = np.abs(phases.force_rate[rows]) / spring_n_per_m
    return np.asarray(speeds[(speeds > 0.0) & np.isfinite(speeds)])
