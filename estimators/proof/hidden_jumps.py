"""Small jumps of a stem slower than DV that the blocks of rows do not show: no proof tells their right place.

Such a stem breaks away, reaches DV, loses its force there and rests again, some hundred times in a ramp. A trifle of
m or DV puts the simulated jumps out of step with the real ones, so that the cost is a comb of minima, and the steps of
a proof come to any of its teeth (``estimators.likelihood.micro_jumps`` says the same of a search), or to a DV just
below the ramp's speed, where there are none: the stem feels F_c and F_v there and not F_s.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.proof import Place
from estimators.proof.whole_motion import SYMBOLS, WholeMotion
from estimators.samples import FloatArray

_FEWEST_BLOCKS: Final = 5
_BELOW: Final = 0.9999  # of DV: at DV itself the stem slides, without a jump
# Of a ramp's speed: a stem with such a DV slides there, and where more than noise is left (in the standard deviations
# of a sum of squares) another one, with a DV above, may have crept. It was 6.4 at a wrong place, at right ones below 0.
_AS_FAST: Final = 0.95
_MORE_THAN_NOISE: Final = 3.0
_LEFT_OVER: Final = 0.5  # of the jumps' sum of squares, at least, by a motion that is out of step
_ALLOWED: Final = 1.2**2 - 1.0  # beyond noise, of the blocks: what an explanation may leave
_USUAL_KG: Final = 3.0  # of the moving parts

_M, _K, _DV = (SYMBOLS.index(symbol) for symbol in ("m", "k", "DV"))


def hidden_jumps_n(seen: WholeMotion, place: Place, motion: RecordedMotion) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide at this place; 0 where none hide.

    Over the second half of a driven stretch the mean of the jumps is a straight line, and what the followed stem leaves
    of it are they. A jump gathers v sqrt(m k) at the speed v.
    """
    time_s, position_m, weight = _followed(seen, place)
    more = place.cost > seen.blocks + _MORE_THAN_NOISE * math.sqrt(2.0 * seen.blocks)
    least = _AS_FAST if more else 1.0 / _BELOW
    squared, fastest = 0.0, 0.0
    for stretch in motion.phases.stretches:
        if not stretch.driven:
            continue
        middle = (stretch.first + stretch.last) // 2
        begin_s, end_s = motion.samples.time_s[[middle, stretch.last]].tolist()
        rows = slice(*np.searchsorted(time_s, [begin_s, end_s]).tolist())
        if rows.stop - rows.start < _FEWEST_BLOCKS:
            continue
        own_s, own_m, own = time_s[rows] - begin_s, position_m[rows], weight[rows]
        speed, start_m = np.polyfit(own_s, own_m, 1, w=own).tolist()
        if least * abs(speed) < float(place.values[_DV]):
            left = (own_m - speed * own_s - start_m) * own
            squared, fastest = squared + 2.0 * float(left @ left), max(fastest, abs(speed))
    if fastest == 0.0 or _LEFT_OVER * squared > _ALLOWED * seen.blocks:
        return 0.0
    return 0.5 * fastest * math.sqrt(max(float(place.values[_M]), _USUAL_KG) * float(place.values[_K]))


def _followed(seen: WholeMotion, place: Place) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time (b,), s, followed position (b,), m, and weight (b,), 1/m, of all blocks."""
    time_s = np.concatenate([section.means(section.time_s) for section in seen.sections])
    measured_m = np.concatenate([section.position_m for section in seen.sections])
    weight = np.concatenate([section.weight for section in seen.sections]) / seen.noise_m
    return time_s, measured_m - place.residual / weight, weight
