"""The two branches of the loop, force against travel, and what lies between and amid them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import fdtri

from estimators.samples import FloatArray, Samples
from estimators.signature.passes import Pass, PassesAtRate
from estimators.signature.scatter import Measured, combined, mean_of_cycles, noise_of_cells

# Own choices.
_CENTRAL: Final = 0.8  # of the travel that both branches cover
_MOST_CELLS: Final = 20
_FEWEST_CELLS: Final = 5
_ROWS_A_CELL: Final = 3
_LEAST_OVERLAP: Final = 0.05  # of the travel of the passes
_VARIES: Final = 0.01  # chance at which noise alone passes for friction that varies over the travel


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """Both branches over the central stroke, of force N against travel m, from one rate's passes.

    ``friction`` is (F_up - F_down)/2: mean over the stroke and least and greatest cell; ``spring`` the slope of the
    mid-line (F_up + F_down)/2, ``middle`` its force at ``middle_m``.
    """

    friction: Measured
    least: Measured
    greatest: Measured
    spring: Measured
    middle: Measured
    middle_m: float
    stroke_m: tuple[float, float]
    speed_m_per_s: float
    rate_n_per_s: float
    cycles: int

    def mid_line(self, travel_m: float) -> Measured:
        """Force of the mid-line at this travel, N."""
        away_m = travel_m - self.middle_m
        value = self.middle.value + self.spring.value * away_m
        return combined(value, (self.middle, 1.0), (self.spring, away_m))


def central_stroke(at_rate: PassesAtRate, noise_m: float) -> tuple[float, float] | None:
    """The middle 80 % of the travel that both branches cover, m; None where they have too little in common.

    Either what every pass covers or what at least one each way does, whichever holds more: (length) sqrt(passes).
    """
    up, down = at_rate.towards(1), at_rate.towards(-1)
    if not up or not down:
        return None
    whole_m = max(one.high_m for one in at_rate.passes) - min(one.low_m for one in at_rate.passes)
    least_m = max(_LEAST_OVERLAP * whole_m, 12.0 * noise_m)
    every = (max(one.low_m for one in at_rate.passes), min(one.high_m for one in at_rate.passes))
    some = (
        max(min(one.low_m for one in way) for way in (up, down)),
        min(max(one.high_m for one in way) for way in (up, down)),
    )
    best: tuple[float, tuple[float, float] | None] = (0.0, None)
    for low_m, high_m in (every, some):
        trim_m = 0.5 * (1.0 - _CENTRAL) * (high_m - low_m)
        stroke_m = (low_m + trim_m, high_m - trim_m)
        shared = min(sum(_covers(one, stroke_m) for one in way) for way in (up, down))
        worth = (high_m - low_m) * math.sqrt(shared) if high_m - low_m >= least_m else 0.0
        if worth > best[0]:
            best = (worth, stroke_m)
    return best[1]


def fit_branches(samples: Samples, at_rate: PassesAtRate, spring_n_per_m: float, *, free: bool) -> Branches | None:
    """Return the branches over the central stroke, or None where the passes do not share one.

    The mean force of each cell of the travel and of each pass, corrected by ``spring_n_per_m`` to the cell's
    middle; not ``free``: there is no spring and its rate stays 0. Errors: noise by the cells' second differences,
    and the scatter between cycles where it is larger.
    """
    stroke_m = central_stroke(at_rate, samples.position_noise_m)
    if stroke_m is None:
        return None
    covering = [one for one in at_rate.passes if _covers(one, stroke_m)]
    if {one.direction for one in covering} != {1, -1}:
        return None
    cells = _cells(samples, covering, stroke_m, spring_n_per_m)
    if cells is None:
        return None
    means, cell_m, covering = cells
    noise_n, freedom = noise_of_cells(means)
    away_m = cell_m - cell_m.mean()
    slopes = means @ away_m / float(away_m @ away_m) if free else np.zeros(len(covering))
    slope_error = noise_n / math.sqrt(float(away_m @ away_m)) if free else 0.0
    upward = np.array([one.direction > 0 for one in covering])
    levels = means.mean(axis=1)
    error_n = noise_n / math.sqrt(cell_m.size)
    up, down = (mean_of_cycles(levels[way], error_n, freedom) for way in (upward, ~upward))
    steep, flat = (mean_of_cycles(slopes[way], slope_error, freedom) for way in (upward, ~upward))
    stroke = stroke_m[1] - stroke_m[0]
    friction = combined(0.5 * (up.value - down.value), (up, 0.5), (down, 0.5)).with_error(at_rate.transient_n)
    spring = combined(spring_n_per_m + 0.5 * (steep.value + flat.value), (steep, 0.5), (flat, 0.5))
    line_n = spring_n_per_m * away_m
    up_n, down_n = means[upward].mean(axis=0) + line_n, means[~upward].mean(axis=0) + line_n
    least, greatest = _extremes(
        0.5 * (up_n - down_n), friction, 0.5 * noise_n * math.sqrt(1.0 / upward.sum() + 1.0 / (~upward).sum()), freedom
    )
    return Branches(
        friction=friction,
        least=least.with_error(0.5 * at_rate.left_n),
        greatest=greatest.with_error(0.5 * at_rate.left_n),
        spring=spring.with_error(6.0 * at_rate.transient_n / stroke) if free else Measured(0.0, 0.0),
        middle=combined(0.5 * (up.value + down.value), (up, 0.5), (down, 0.5)).with_error(at_rate.transient_n),
        middle_m=float(cell_m.mean()),
        stroke_m=stroke_m,
        speed_m_per_s=at_rate.speed_m_per_s,
        rate_n_per_s=at_rate.rate_n_per_s,
        cycles=int(min(upward.sum(), (~upward).sum())),
    )


def _covers(one: Pass, stroke_m: tuple[float, float]) -> bool:
    """Whether a pass goes over all of the stroke: one that begins inside would put one-sided noise into a cell."""
    return one.low_m <= stroke_m[0] and one.high_m >= stroke_m[1]


def _cells(
    samples: Samples, passes: list[Pass], stroke_m: tuple[float, float], spring_n_per_m: float
) -> tuple[FloatArray, FloatArray, list[Pass]] | None:
    """Mean of F - k (x - middle of the stroke) by pass and cell, (n_passes, n_cells), the cells' middles, m.

    With the passes that have no empty cell; at first as many cells as leave most passes whole, else any one each way.
    To sort by the noisy travel makes no bias: about as many samples come in over an edge as go out.
    """
    count = _MOST_CELLS
    while count >= _FEWEST_CELLS:
        means = np.array([_cell_means(samples, one, stroke_m, spring_n_per_m, count) for one in passes])
        whole = np.isfinite(means).all(axis=1)
        kept = [one for one, full in zip(passes, whole, strict=True) if full]
        last = count * 3 // 4 < _FEWEST_CELLS
        if {one.direction for one in kept} == {1, -1} and (last or 2 * len(kept) > len(passes)):
            width_m = (stroke_m[1] - stroke_m[0]) / count
            return means[whole], stroke_m[0] + width_m * (np.arange(count, dtype=np.float64) + 0.5), kept
        count = count * 3 // 4
    return None


def _cell_means(
    samples: Samples, one: Pass, stroke_m: tuple[float, float], spring_n_per_m: float, count: int
) -> FloatArray:
    """Mean of F - k (x - middle of the stroke) by cell, shape (count,); NaN where a cell has too few rows."""
    position_m = samples.position_m[one.rows]
    inside = (position_m >= stroke_m[0]) & (position_m < stroke_m[1])
    position_m = position_m[inside]
    cell = ((position_m - stroke_m[0]) / (stroke_m[1] - stroke_m[0]) * count).astype(np.int64)
    cell = np.minimum(cell, count - 1)
    force_n = samples.force_n[one.rows[inside]] - spring_n_per_m * (position_m - 0.5 * (stroke_m[0] + stroke_m[1]))
    held = np.bincount(cell, minlength=count)
    means = np.full(count, np.nan)
    enough = held >= _ROWS_A_CELL - 1
    means[enough] = np.bincount(cell, force_n, count)[enough] / held[enough]
    return means


def _extremes(
    friction_n: FloatArray, mean: Measured, noise_n: float, noise_freedom: float
) -> tuple[Measured, Measured]:
    """Least and greatest friction over the cells (n,), drawn to the mean by as much as noise explains.

    The extremes of noisy cells lie outside those of the friction; James and Stein's factor 1 - noise/variance
    takes that back. Where noise, known with ``noise_freedom``, explains all of it (F-test at 1 %), both are the mean.
    """
    off_n = friction_n - friction_n.mean()
    variance, freedom = float(off_n @ off_n), off_n.size - 1
    if variance <= freedom * float(fdtri(freedom, noise_freedom, 1.0 - _VARIES)) * noise_n**2 + 1.0e-16 * mean.value**2:
        return mean, mean
    share = max(0.0, 1.0 - freedom * noise_n**2 / variance)
    cell = Measured(0.0, math.sqrt(share) * noise_n)
    ends = (mean.value + share * float(off_n.min()), mean.value + share * float(off_n.max()))
    return combined(ends[0], (mean, 1.0), (cell, 1.0)), combined(ends[1], (mean, 1.0), (cell, 1.0))
