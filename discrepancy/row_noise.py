"""What the rows of a position are off by: noise, a converter's steps, and the instants of polled writes and looks."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.likelihood.inputs.row_timing import position_doubts, shared_by_rest, still_rows
from estimators.likelihood.row_weights import independent_share, row_noise
from estimators.likelihood.start import resting_rows
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray, position_noise

_NO_NOISE: Final = 1.0e-7  # of the travel: a position without noise is still only as good as its model
_ENOUGH_AT_REST: Final = 100
_SURELY_LESS: Final = 0.8


def resting_noise(motion: RecordedMotion) -> float:
    """Noise of the position, one standard deviation, m: no more than what is seen at rest.

    Where one step of the converter is more than that, a rest repeats its error and shows none: the steps count.
    """
    samples = motion.samples
    noise_m = samples.position_noise_m
    resting = np.flatnonzero(resting_rows(motion))
    if noise_m > 0.0 and resting.size >= _ENOUGH_AT_REST:
        run_first = np.maximum.accumulate(np.where(np.diff(resting, prepend=-2) > 1, np.arange(resting.size), 0))
        at_rest_m = position_noise(samples.time_s[resting], samples.position_m[resting], run_first)
        if 0.0 < at_rest_m < _SURELY_LESS * noise_m:
            noise_m = at_rest_m
    if samples.position_step_m > noise_m > 0.0:
        noise_m = row_noise(motion)
    return max(noise_m, _NO_NOISE * float(np.ptp(samples.position_m)))


def repeated_errors(motion: RecordedMotion, noise_m: float) -> FloatArray:
    """Variance of each row beside that of the noise, m2, (n,): rows on one step of the converter share its error."""
    share = independent_share(motion.samples, noise_m)
    return np.asarray(noise_m**2 * (1.0 / share**2 - 1.0))


def timing_errors(motion: RecordedMotion, noise_m: float) -> FloatArray:
    """What the instants of polled writes and looks leave unknown of each position, m, (n,): more where rests share."""
    samples = motion.samples
    if motion.recording is None:
        return np.zeros(samples.count)
    doubts = position_doubts(motion.recording, samples.time_s, samples.position_m, samples.position_noise_m)
    if not doubts.lasting_m.any():
        return doubts.total_m
    total_m = np.hypot(noise_m, doubts.total_m)
    share = shared_by_rest(still_rows(samples.position_m, samples.position_noise_m), total_m, doubts.lasting_m)
    return np.asarray(np.sqrt(np.maximum((total_m / share) ** 2 - noise_m**2, 0.0)))
