"""Whether the fitted stem goes in small jumps that hide in the noise (``estimators.motion.hidden_jumps``)."""

from __future__ import annotations

from typing import Final

from estimators.likelihood.certificate import LARGEST_RATIO
from estimators.likelihood.model import StemModel
from estimators.motion.hidden_jumps import SLIDES, Followed, hidden_jumps_n
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

_FEWEST_ROWS: Final = 20


def hidden_micro_jumps_n(model: StemModel, point: FloatArray, motion: RecordedMotion) -> float:
    """Half of the force, N, that the stem may gather in jumps that hide at ``point`` (p,); 0 where none hide."""
    position_m = model.simulate(point)
    if position_m is None:
        return 0.0
    values = model.coordinates.values(point)
    return hidden_jumps_n(
        Followed(model.time_s, position_m, model.weight, values["m"], values["k"]),
        motion,
        below_speed=SLIDES * values["DV"],
        fewest=_FEWEST_ROWS,
        allowed=(LARGEST_RATIO**2 - 1.0) * model.time_s.size,
    )
