"""What a force balance misses at the same places or speeds on every stroke: a friction that the model has not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.drive.fit import ForceFit, by_waves, influences
from estimators.motion.moving_rows import MovingRows
from estimators.samples import FloatArray, Samples

_PLACES: Final = 60  # each way; own choice: a spot of a tenth of the stroke lies on several
_FEWEST_STROKES: Final = 4
# Own choices. Of simulated axes noise gives at most 0, a spot of 10 % of F_c and more at least 0.83; the ball screw of
# EMPS gives 0.49, and its values are right.
_MOST: Final = 0.6
_FEWEST_SEEN: Final = 0.5  # of the rows: on places that other strokes went over the same way
_TRIFLE: Final = 0.005  # of the friction: what no noise covers is locked to the motion, however little it is


@dataclass(frozen=True, slots=True)
class RepeatedMisfit:
    """Share of the residual's mean square that the other strokes foretell, and the residual's rms there, N."""

    share: float
    rms_n: float

    def is_much(self, friction_n: float) -> bool:
        """Whether it is most of the residual, and no trifle of the friction (N)."""
        return self.share > _MOST and math.sqrt(self.share) * self.rms_n > _TRIFLE * friction_n


def repeated_misfit(samples: Samples, moving: MovingRows, fit: ForceFit) -> RepeatedMisfit:
    """Foretell each stroke's residual, place by place, as the mean of the other strokes the same way.

    Noise, however slow, is not foretold: its share is below 0. The share is 0 where too few strokes meet.
    """
    rows = fit.rows & (moving.sense != 0)
    sense, residual = moving.sense[rows].astype(np.int64), fit.residual_n[rows]
    stroke = np.cumsum(np.concatenate([[False], sense[1:] != sense[:-1]]))
    strokes = int(stroke.max(initial=-1)) + 1
    if strokes < _FEWEST_STROKES:
        return RepeatedMisfit(0.0, fit.residual_rms_n)
    position_m = samples.position_m[rows]
    along = (position_m - position_m.min()) / max(float(np.ptp(position_m)), np.finfo(float).tiny)
    place = np.minimum((_PLACES * along).astype(np.int64), _PLACES - 1) + _PLACES * (sense > 0)
    sums, counts = np.zeros((strokes, 2 * _PLACES)), np.zeros((strokes, 2 * _PLACES))
    np.add.at(sums, (stroke, place), residual)
    np.add.at(counts, (stroke, place), 1.0)
    others = (counts.sum(axis=0) - counts)[stroke, place]
    seen = others > 0.0
    size = float(residual[seen] @ residual[seen])
    if not (seen.mean() > _FEWEST_SEEN and size > 0.0):
        return RepeatedMisfit(0.0, fit.residual_rms_n)
    foretold = (sums.sum(axis=0) - sums)[stroke, place][seen] / others[seen]
    left = residual[seen] - foretold
    return RepeatedMisfit(1.0 - float(left @ left) / size, math.sqrt(size / np.count_nonzero(seen)))


def locked_errors(samples: Samples, fit: ForceFit) -> FloatArray:
    """Standard errors, shape (4,), of a residual that is locked to the motion: the larger of by place and by speed.

    What comes back on every stroke is quick in time and averages out there, but not in the coefficients. With the rows
    in the order of the places, each way by itself, or of the speeds, it is slow, and the slow scores show it.
    """
    rows = np.flatnonzero(fit.rows)
    influence, speed = influences(fit)[rows], fit.regressors[rows, 1]
    places = np.lexsort((samples.position_m[rows] * np.sign(speed), np.sign(speed)))
    variances = [np.diag(by_waves(influence[order])) for order in (places, np.argsort(speed, kind="stable"))]
    return np.asarray(np.sqrt(np.max(variances, axis=0)))
