"""The middle of what a limit velocity may be: where a test hardly shows DV, the other values follow it there.

The cost is flat in ln DV then, but m, F_v and F_c bend with DV, so that the lowest place of the cost, which noise moves
far along DV, is no middle of anything: its error is several times that of the parabola at the truth.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.base import LARGEST_RELATIVE_HALF_WIDTH, NORMAL_95
from estimators.likelihood.pool import Place
from estimators.samples import FloatArray

_GRID: Final = 400
_FELL: Final = 4.0  # of the cost, at both ends: else what lies beyond is not known


def median_place(walked: list[Place], number: int, *, noise_factor: float) -> FloatArray | None:
    """Return the point (p,) at the median of the unknown ``number``, a logarithm, along its profile.

    ``walked`` are places at which all other unknowns are at their best. The profile exp(-cost / (2 noise_factor^2))
    holds the prior. None where the walk did not come far enough, or where the unknown is known to +-30 %, so that the
    parabola at the bottom tells of it.
    """
    ordered = sorted(walked, key=lambda place: float(place.point[number]))
    at = np.array([place.point[number] for place in ordered])
    cost = np.array([place.cost for place in ordered]) / noise_factor**2
    if at.size < 3 or min(cost[0], cost[-1]) - float(cost.min()) < _FELL:
        return None
    grid = np.linspace(at[0], at[-1], _GRID)
    share = np.exp(-0.5 * (np.interp(grid, at, cost) - float(cost.min())))
    share /= share.sum()
    middle = float(share @ grid)
    if NORMAL_95 * math.sqrt(float(share @ (grid - middle) ** 2)) < math.log1p(LARGEST_RELATIVE_HALF_WIDTH):
        return None
    median = float(np.interp(0.5, np.cumsum(share) - 0.5 * share, grid))
    points = np.stack([place.point for place in ordered])
    return np.array([np.interp(median, at, column) for column in points.T])
