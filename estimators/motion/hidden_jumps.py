"""Small jumps of a stem that is slower than DV: where they do not show, a motion that is out of step does not either.

Such a stem breaks away, reaches DV, loses its force there and rests again, some hundred times in a ramp. A trifle of
m or DV puts the followed jumps out of step with the real ones, so that the cost is a comb of minima, and a search or
the steps of a proof may come to any of its teeth. A wrong tooth leaves no more than the jumps themselves are: where
that is less than what an explanation may leave, none can be told from the right one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

HIDDEN_JUMPS: Final = (
    "the stem is slower than DV on some ramps, and the small jumps that it goes in there do not show beside the noise, "
    "so that other m, F_v, F_c, F_s and DV may explain it as well: repeat with faster ramps"
)
SLIDES: Final = 0.9999  # of DV: at DV itself the stem slides, without a jump
_LEFT_OVER: Final = 0.5  # of the jumps' sum of squares, at least, by a motion that is out of step
_USUAL_KG: Final = 3.0  # of the moving parts: the jumps are as its root, and a wrong tooth may have any


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A motion as it is followed: times, s, positions, m, and their weights, 1/m, each (n,); its m, kg, and k, N/m."""

    time_s: FloatArray
    position_m: FloatArray
    weight: FloatArray
    mass_kg: float
    spring_n_per_m: float


def hidden_jumps_n(
    followed: Followed, motion: RecordedMotion, *, below_speed: float, fewest: int, allowed: float
) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide; 0 where none hide.

    Looked at are stretches slower than ``below_speed``, m/s, of at least ``fewest`` values in their second half: there
    the mean of the jumps is a straight line, and what the followed stem leaves of it are they. They hide where a
    motion out of step leaves less than the sum of squares ``allowed``. A jump gathers v sqrt(m k) at the speed v.
    """
    squared, fastest = 0.0, 0.0
    for stretch in motion.phases.stretches:
        if not stretch.driven:
            continue
        begin_s, end_s = motion.samples.time_s[[(stretch.first + stretch.last) // 2, stretch.last]].tolist()
        rows = slice(*np.searchsorted(followed.time_s, [begin_s, end_s]).tolist())
        if rows.stop - rows.start < fewest:
            continue
        own_s, own_m, weight = followed.time_s[rows] - begin_s, followed.position_m[rows], followed.weight[rows]
        speed, start_m = np.polyfit(own_s, own_m, 1, w=weight).tolist()
        if abs(speed) < below_speed:
            left = (own_m - speed * own_s - start_m) * weight
            squared, fastest = squared + 2.0 * float(left @ left), max(fastest, abs(speed))
    if fastest == 0.0 or _LEFT_OVER * squared > allowed:
        return 0.0
    return 0.5 * fastest * math.sqrt(max(followed.mass_kg, _USUAL_KG) * followed.spring_n_per_m)
