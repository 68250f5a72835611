"""The noise of a position, and what each row of it weighs: with the steps of a converter and what rows share."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.inputs.row_timing import PositionDoubts, position_doubts, shared_by_rest, still_rows
from estimators.likelihood.level_kernel import level_runs
from estimators.likelihood.start import resting_rows
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray, Samples

# Own choices.
_SURELY_LESS: Final = 0.8
_ENOUGH_AT_REST: Final = 16  # rows of one rest
_REST_ENDS: Final = 3
_MOSTLY_STEPS: Final = 0.85
_KEPT: Final = 0.95
_KEPT_VARIANCE: Final = 0.759  # of a normal number that is among the 95 % nearest to its mean
_MOST_ROUNDED: Final = 1.5
_TRIFLE: Final = 1.0e-6  # of the noise's square: even a rest of a minute at 1 kHz does not show it
_AT_REST_ROWS: Final = 10
_WITHIN_STEPS: Final = 0.75  # of the grid, from the mean of a run: one value and its neighbours now and then
_ROUNDED_STEPS: Final = 0.5  # of the grid: what rounding itself moves a row
_SHAKEN_SIGMAS: Final = 4.0


def row_noise(motion: RecordedMotion) -> float:
    """Noise of the position, one standard deviation, m: as seen at rest, with the steps of a converter in it."""
    return _rounded_noise(motion.samples, _noise(motion))


def _noise(motion: RecordedMotion) -> float:
    """Noise of the position, m: what is seen at rest where that is clearly less, for slips add nothing to it there.

    Median over the rests of the scatter about a line, each rest without its ends.
    """
    samples = motion.samples
    resting = resting_rows(motion)
    edges = np.flatnonzero((resting[1:] != resting[:-1]) | (samples.run_first[1:] != samples.run_first[:-1])) + 1
    bounds = np.concatenate([[0], edges, [resting.size]])
    found_m, rows = [], []
    for first, last in pairwise(bounds.tolist()):
        own_m = samples.position_m[first + _REST_ENDS : last - _REST_ENDS]
        if not resting[first] or own_m.size < _ENOUGH_AT_REST:
            continue
        time_s = samples.time_s[first + _REST_ENDS : last - _REST_ENDS]
        time_s = time_s - time_s.mean()
        off_m = own_m - own_m.mean()
        off_m = off_m - time_s * float(time_s @ off_m) / float(time_s @ time_s)
        found_m.append(math.sqrt(float(off_m @ off_m) / (own_m.size - 2)))
        rows.append(own_m.size)
    if sum(rows) < 10 * _ENOUGH_AT_REST or len(rows) < 2:
        return samples.position_noise_m
    order = np.argsort(found_m)
    middle = int(np.searchsorted(np.cumsum(np.array(rows)[order]), 0.5 * sum(rows)))
    at_rest_m = found_m[int(order[middle])]
    surely_less = 0.0 < at_rest_m < _SURELY_LESS * samples.position_noise_m
    least_m = max(resolution_noise(samples.position_m), samples.position_step_m / math.sqrt(12.0))
    return max(at_rest_m, least_m) if surely_less else samples.position_noise_m


def _rounded_noise(samples: Samples, noise_m: float) -> float:
    """Noise of a position whose steps hide it, m, with these: by the trimmed mean of the squared 4th differences.

    On a coarse grid the median of the differences is one of a few numbers.
    """
    steps_m = samples.position_step_m / math.sqrt(12.0)
    if steps_m < _MOSTLY_STEPS * noise_m or samples.position_noise_m == 0.0:
        return noise_m
    inside = samples.run_first[4:] == samples.run_first[:-4]
    fourth = np.sort(np.abs(np.diff(samples.position_m, 4))[inside]) / math.sqrt(70.0)
    kept = fourth[: int(_KEPT * fourth.size)]
    if kept.size == 0:
        return noise_m
    trimmed_m = math.sqrt(float(kept @ kept) / kept.size / _KEPT_VARIANCE)
    return min(max(noise_m, trimmed_m), _MOST_ROUNDED * steps_m)


def row_weights(motion: RecordedMotion, noise_m: float) -> FloatArray:
    """Weight of each row, 1/m, shape (n,): the noise, the motion within its timing, and what rows have in common."""
    samples, recording = motion.samples, motion.recording
    if recording is None:
        return independent_share(samples, noise_m) / noise_m
    own_m = samples.position_noise_m
    doubts = position_doubts(recording, samples.time_s, samples.position_m, own_m)
    return weight_of(samples, noise_m, doubts, still_rows(samples.position_m, own_m))


def weight_of(samples: Samples, noise_m: float, doubts: PositionDoubts, still: BoolArray) -> FloatArray:
    """Weight of each row, 1/m, shape (n,), for this noise and these doubts; ``still`` are the rows of rests."""
    total_m = np.hypot(noise_m, doubts.total_m)
    alone = independent_share(samples, noise_m) / total_m
    return alone * shared_by_rest(still, total_m, doubts.lasting_m) if doubts.lasting_m.any() else alone


def resolution_noise(position_m: FloatArray) -> float:
    """Noise of a sensor's steps, step / sqrt(12), m: the smallest change that is no rounding; an upper bound of it."""
    change_m = np.abs(np.diff(position_m))
    change_m = change_m[change_m > 1.0e-9 * float(np.ptp(position_m))]
    is_stepped = change_m.size > 0 and np.unique(np.round(change_m / change_m.min(), 3)).size < 0.1 * change_m.size
    return float(change_m.min()) / math.sqrt(12.0) if is_stepped else 0.0


def repeated_share(samples: Samples, noise_m: float) -> float:
    """Share of the noise's variance that rounding to a step repeats: no more than 1, 0 where no step is known."""
    step_m = samples.position_step_m
    if samples.position_noise_m == 0.0 or step_m == 0.0:
        return 0.0
    rounding = step_m**2 / 12.0
    shaken = max(noise_m**2 - rounding, 0.0)
    return min(rounding * math.exp(-((2.0 * math.pi) ** 2) * shaken / step_m**2) / noise_m**2, 1.0)


def independent_share(samples: Samples, noise_m: float) -> FloatArray:
    """Weight of each row, shape (n,), as a share of that of a row whose error is its own.

    Rounding to a step q repeats its error b while the stem stays within the step: n such rows tell of its level
    n / (1 + (n - 1) b^2/noise^2) times what one does, and so do all rests within one step. Noise s before the rounding
    makes it independent: b^2 is q^2/12 exp(-(2 pi s/q)^2), the first harmonic of the rounded noise's mean. A run is
    as wide as that noise scatters its rows: were a rest cut where a row differs, its weights would go by the noise, and
    so would its level.
    """
    step_m, repeated = samples.position_step_m, repeated_share(samples, noise_m)
    share = np.ones(samples.count)
    if repeated < _TRIFLE:
        return share
    shaken_m = math.sqrt(max(noise_m**2 - step_m**2 / 12.0, 0.0))
    within_m = max(_WITHIN_STEPS * step_m, _ROUNDED_STEPS * step_m + _SHAKEN_SIGMAS * shaken_m)
    runs = level_runs(samples.position_m, samples.run_last, within_m, 2)
    lengths = runs[:, 1] - runs[:, 0] + 1
    step_of = np.rint(np.array([float(np.median(samples.position_m[i : j + 1])) for i, j in runs]) / step_m)
    # a stem that comes to rest at the same place in each cycle meets the same error there
    steps, group = np.unique(step_of, return_inverse=True)
    alike = np.bincount(group, weights=lengths, minlength=steps.size)[group]
    for (first, last), rows in zip(runs, np.where(lengths >= _AT_REST_ROWS, alike, lengths), strict=True):
        share[first : last + 1] = 1.0 / math.sqrt(1.0 + (float(rows) - 1.0) * repeated)
    return share
