"""Whether the fitted stem goes in small jumps that hide in the noise (``estimators.motion.hidden_jumps``)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from estimators.likelihood.certificate import LARGEST_RATIO
from estimators.likelihood.model import StemModel
from estimators.likelihood.stand_ins import with_any_limit
from estimators.motion.hidden_jumps import SLIDES, Followed, hidden_jumps_n
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

_FEWEST_ROWS: Final = 20
_AT_RIM: Final = 1.001  # of DV: fits that slide at a ramp's speed are within 1e-4 of it
_BEYOND: Final = 1.05  # of DV: the stem goes in jumps, many of them in a ramp
_MOST_EVENTS: Final = 50_000  # of small jumps


def hidden_micro_jumps_n(model: StemModel, point: FloatArray, motion: RecordedMotion) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide at ``point`` (p,); 0 where none hide.

    A fit may have a DV that is a ramp's speed: the stem slides there, and with a DV a trifle higher it jumps. Where
    those jumps would hide it was driven to that rim, and the DVs beyond explain the rows as well.
    """
    allowed = (LARGEST_RATIO**2 - 1.0) * model.time_s.size
    own_n = _hidden_n(model, point, motion, SLIDES, allowed)
    if own_n > 0.0 or _hidden_n(model, point, motion, _AT_RIM, math.inf) == 0.0:
        return own_n
    open_model = with_any_limit(replace(model, most_events=max(model.most_events, _MOST_EVENTS)))
    values = model.coordinates.values(point)
    beyond = open_model.coordinates.point(values | {"DV": _BEYOND * values["DV"]})
    return _hidden_n(open_model, beyond, motion, SLIDES, allowed)


def _hidden_n(model: StemModel, point: FloatArray, motion: RecordedMotion, share: float, allowed: float) -> float:
    """The same of the stretches slower than this share of DV, of jumps with at most this sum of squares."""
    position_m = model.simulate(point)
    if position_m is None:
        return 0.0
    values = model.coordinates.values(point)
    return hidden_jumps_n(
        Followed(model.time_s, position_m, model.weight, values["m"], values["k"]),
        motion,
        below_speed=share * values["DV"],
        fewest=_FEWEST_ROWS,
        allowed=allowed,
    )
