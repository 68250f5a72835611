"""Whether a stem at a proven place goes in small jumps that blocks of rows do not show.

``estimators.motion.hidden_jumps`` says what these are. The steps of a proof may also come to a DV just below the
ramp's speed, where there are none: the stem feels F_c and F_v there and not F_s.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.motion.hidden_jumps import SLIDES, Followed, hidden_jumps_n
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.proof import Place
from estimators.proof.whole_motion import SYMBOLS, WholeMotion

_FEWEST_BLOCKS: Final = 5
# Of a ramp's speed: a stem with such a DV slides there, and where more than noise is left (in the standard deviations
# of a sum of squares) another one, with a DV above, may have crept. It was 6.4 at a wrong place, at right ones below 0;
# 1.9 at one that a mass of 83 kg made up for, and 5.6 with the nameplate's.
_AS_FAST: Final = 0.95
_MORE_THAN_NOISE: Final = 3.0
_ALLOWED: Final = 1.2**2 - 1.0  # beyond noise, of the blocks: what an explanation may leave

_M, _K, _DV = (SYMBOLS.index(symbol) for symbol in ("m", "k", "DV"))


def hidden_block_jumps_n(seen: WholeMotion, place: Place, motion: RecordedMotion, own_cost: float) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide at this place; 0 where none hide.

    ``own_cost`` is the sum of squares that the estimate's own values leave: the steps of a proof may come to less by a
    mass that no valve has.
    """
    more = max(place.cost, own_cost) > seen.blocks + _MORE_THAN_NOISE * math.sqrt(2.0 * seen.blocks)
    return hidden_jumps_n(
        _followed(seen, place),
        motion,
        below_speed=float(place.values[_DV]) * (1.0 / _AS_FAST if more else SLIDES),
        fewest=_FEWEST_BLOCKS,
        allowed=_ALLOWED * seen.blocks,
    )


def _followed(seen: WholeMotion, place: Place) -> Followed:
    """Return all blocks as the stem is followed at this place."""
    time_s = np.concatenate([section.means(section.time_s) for section in seen.sections])
    measured_m = np.concatenate([section.position_m for section in seen.sections])
    weight = np.concatenate([section.weight for section in seen.sections]) / seen.noise_m
    mass_kg, spring_n_per_m = float(place.values[_M]), float(place.values[_K])
    return Followed(time_s, measured_m - place.residual / weight, weight, mass_kg, spring_n_per_m)
