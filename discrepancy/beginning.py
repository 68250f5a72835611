"""Where the stem is when a recording begins, and whether it moves there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.windowed_slope import windowed_slope_noise

_ROWS: Final = 50
# Own choices, standard deviations.
_OUT_OF_BALANCE: Final = 6.0
_MOVING: Final = 4.0
_SPEEDS: Final = 2.0  # of the speeds shown, by which a velocity that changes within a window may be off


@dataclass(frozen=True, slots=True)
class Beginning:
    """Where the stem is at a row, and its velocity there, m and m/s, with their errors, one standard deviation.

    ``velocity_error`` is 0 where the velocity is known as well as matters.
    """

    position_m: float
    position_error_m: float
    velocity: float = 0.0
    velocity_error: float = 0.0


def beginning(motion: RecordedMotion, first: int, noise_m: float) -> Beginning:
    """Return how the stem begins at a row; at rest its place is the mean of what rests on.

    A stem that gives elastically creeps from the first row on, and phases have no rest there: it moves only where its
    velocity over a whole window is more than noise. Where it slips within that window, let go out of balance or caught
    in the middle of a slip, the window says little about the first row.
    """
    position_m, phases, period_s = motion.samples.position_m, motion.phases, motion.samples.period_s
    coming = [stretch.first for stretch in phases.stretches if stretch.last >= first]
    still = (coming[0] if coming else position_m.size) - first
    if still < 3:
        half = max(phases.half_window, 1)
        whole = min(first + half, position_m.size - 1)
        error = windowed_slope_noise(noise_m, half, period_s)
        settled = float(phases.velocity[whole])
        if abs(settled) > _MOVING * error:
            velocity = float(phases.velocity[first : first + 3].mean())
            changes = abs(velocity - settled) > _MOVING * math.sqrt(2.0) * error
            doubt = _SPEEDS * max(abs(velocity), abs(settled)) if changes else 0.0
            return Beginning(float(position_m[first]), noise_m, velocity, doubt)
        still = half
    own_m = position_m[first : first + min(still, _ROWS)]
    if abs(float(position_m[first]) - float(own_m.mean())) > _OUT_OF_BALANCE * noise_m:
        # out of balance the stem leaves its first position before the second sample or so
        return Beginning(float(position_m[first]), noise_m)
    return Beginning(float(own_m.mean()), noise_m / math.sqrt(own_m.size))


def last_motion(motion: RecordedMotion, first: int) -> tuple[float, float]:
    """Return the direction of the last motion begun before a row, and when it ended, s from the recording's start.

    0 and 0 where the stem had not moved yet; where it still moves, the time is that of the row.
    """
    time_s = motion.samples.time_s
    begun = [stretch for stretch in motion.phases.stretches if stretch.first < first]
    if not begun:
        return 0.0, 0.0
    return float(begun[-1].direction), float(time_s[min(begun[-1].last, first)] - time_s[0])
