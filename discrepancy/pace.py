"""How fast a measured stem is from row to row."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

_BESIDE: Final = 2  # rows before and after one, over which it may have been fast
_SURELY_MOVED: Final = 6.0  # standard deviations of one row


def speeds(motion: RecordedMotion) -> FloatArray:
    """Return the speed at each row, m/s, shape (n,): over the window of the phases, or over five rows if that is more.

    A window as wide as the noise asks for is many times as long as a slip, in which the stem is ten times as fast.
    """
    samples = motion.samples
    windowed = np.abs(motion.phases.velocity)
    if samples.count <= 2 * _BESIDE:
        return windowed
    change_m = np.abs(samples.position_m[2 * _BESIDE :] - samples.position_m[: -2 * _BESIDE])
    span_s = samples.time_s[2 * _BESIDE :] - samples.time_s[: -2 * _BESIDE]
    own = np.zeros(samples.count)
    own[_BESIDE:-_BESIDE] = np.where(change_m > _SURELY_MOVED * samples.position_noise_m, change_m / span_s, 0.0)
    return np.asarray(np.maximum(windowed, own))
