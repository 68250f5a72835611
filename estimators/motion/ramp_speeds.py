"""The speed that the stem tends to on its ramp: slope of the force over spring rate."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.motion.phases import Phases, Stretch
from estimators.samples import FloatArray, IntArray, Samples

_LINE_ROWS: Final = 400  # of the ramp that a stretch lies on
_SHARE_OFF_LINE: Final = 1.0e-3  # of the force's change: what still counts as a straight line


def ramp_speeds(samples: Samples, phases: Phases, spring_n_per_m: float) -> FloatArray:
    """Force slope over k, m/s, shape (n,): one value a stretch on a straight ramp, else row by row; 0 at rest.

    Motion is affine plus transients about this speed, which is what the bias of backward differences hangs on.
    """
    speeds = np.zeros(samples.count)
    for stretch in phases.stretches:
        slope = _line_slope(samples, stretch, phases.corners)
        speeds[stretch.rows] = phases.force_rate[stretch.rows] if slope is None else slope
    return np.asarray(speeds / spring_n_per_m)


def _line_slope(samples: Samples, stretch: Stretch, corners: IntArray) -> float | None:
    """Slope of the ramp that the stretch lies on, N/s, also beyond the stretch; None where it is not straight."""
    first = stretch.first
    last = min(first + _LINE_ROWS, int(samples.run_last[first]))
    later = corners[corners > first]
    if later.size:
        last = min(last, int(later[0]) - 1)
    last = max(last, first + 1)
    slope, off_line = _fitted(samples, slice(first, last + 1))
    if last < stretch.last:
        # the whole stretch decides whether the line is straight, its own slope is the better one then
        slope, off_line = _fitted(samples, stretch.rows)
    change = abs(slope) * float(samples.time_s[max(last, stretch.last)] - samples.time_s[first])
    return slope if off_line <= _SHARE_OFF_LINE * change + 3.0 * samples.force_noise_n else None


def _fitted(samples: Samples, rows: slice) -> tuple[float, float]:
    """Slope of the force over these rows, N/s, and the root mean square of what is off the line, N."""
    time_s = samples.time_s[rows] - float(samples.time_s[rows].mean())
    force_n = samples.force_n[rows] - float(samples.force_n[rows].mean())
    slope = float(time_s @ force_n) / float(time_s @ time_s)
    return slope, float(np.sqrt(np.mean((force_n - slope * time_s) ** 2)))
