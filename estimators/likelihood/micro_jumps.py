"""Small jumps of a stem that is slower than DV: where they do not show, a fit that is out of step with them does not.

Such a stem breaks away, reaches DV, loses its force there and rests again, some hundred times in a ramp. A trifle of
m or DV puts the simulated jumps out of step with the real ones, so that the cost is a comb of minima, and a search may
come to any of its teeth. A wrong tooth leaves no more than the jumps themselves are: where that is less than what the
certificate allows, no fit can be told from the right one.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.likelihood.certificate import LARGEST_RATIO
from estimators.likelihood.model import StemModel
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

_FEWEST_ROWS: Final = 20
_LEFT_OVER: Final = 0.5  # of the jumps' sum of squares, at least, by a fit that is out of step
_BELOW: Final = 0.9999  # of DV: at DV itself the stem slides, without a jump
_USUAL_KG: Final = 3.0  # of the moving parts: the jumps are as its root, and a wrong tooth may have any


def hidden_jumps_n(model: StemModel, point: FloatArray, motion: RecordedMotion) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide at ``point`` (p,); 0 where none hide.

    Over the second half of a driven stretch that is slower than DV the mean of the jumps is a straight line, and what
    the simulated stem leaves of it are they. A jump gathers v sqrt(m k) at the speed v, of whatever mass.
    """
    position_m = model.simulate(point)
    if position_m is None:
        return 0.0
    values, time_s = model.coordinates.values(point), motion.samples.time_s
    squared, fastest = 0.0, 0.0
    for stretch in motion.phases.stretches:
        middle = (stretch.first + stretch.last) // 2
        if not stretch.driven or stretch.last - middle < _FEWEST_ROWS:
            continue
        first, last = np.searchsorted(model.time_s, time_s[[middle, stretch.last]]).tolist()
        own_s, own_m = model.time_s[first:last] - time_s[middle], position_m[first:last]
        speed, start_m = np.polyfit(own_s, own_m, 1).tolist() if own_s.size >= _FEWEST_ROWS else (math.inf, 0.0)
        if abs(speed) < _BELOW * values["DV"]:
            left = (own_m - speed * own_s - start_m) * model.weight[first:last]
            squared, fastest = squared + 2.0 * float(left @ left), max(fastest, abs(speed))
    if fastest == 0.0 or _LEFT_OVER * squared > (LARGEST_RATIO**2 - 1.0) * model.time_s.size:
        return 0.0
    return 0.5 * fastest * math.sqrt(max(values["m"], _USUAL_KG) * values["k"])
