"""How fast a measured stem is from row to row, and what their instants leave unknown of its places."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

_BESIDE: Final = 2  # rows before and after one, over which it may have been fast, or its speed may change
# Timing that nobody vouches for, as a share of the period: else the few samples of a slip outweigh all others.
_TIMING_SHARE: Final = 0.2
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


def timing_doubts(motion: RecordedMotion, vouched_s: float | None) -> FloatArray:
    """What the instants of the rows leave unknown of each position, m, (n,), ``vouched_s`` being what is said of it.

    A delay that all rows share is fitted: where the stem is steady, what is said of them is all that is left. Where its
    speed changes from row to row, as in a slip, the instant of the change is no better known than nobody's word.
    """
    unsaid_s, speed = _TIMING_SHARE * motion.samples.period_s, speeds(motion)
    if vouched_s is None:
        return np.asarray(speed * unsaid_s)
    near = np.lib.stride_tricks.sliding_window_view(np.pad(speed, _BESIDE, mode="edge"), 2 * _BESIDE + 1)
    changed = near.max(axis=1) - near.min(axis=1)
    return np.asarray(np.hypot(speed * vouched_s, changed * max(unsaid_s, vouched_s)))
