"""The rows of a recording as few blocks, for the search: a stem at rest or in uniform motion needs hardly any."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.block_kernel import straight_blocks
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.samples import BoolArray, FloatArray, IntArray

# Own choices: what joining two lines may add to the squares (2 in the mean), and the longest block as a share of all.
_LIMITS: Final = (9.0, 25.0, 100.0)
_LONGEST_SHARE: Final = 1.0 / 150.0
_FEWEST_LONGEST: Final = 8
_MOST_RESTS: Final = 96
_FEWEST_PARTS: Final = 4
_MOST_BLOCKS: Final = 3000
_BLOCKS_AN_EVENT: Final = 4
_OUTLYING: Final = 10.0  # times the median of the parts' mean squares
_MOST_OUTLYING: Final = 0.3  # of the parts
_BENT: Final = 0.1  # of the noise, from one row to the next
_ABOUT: Final = 3  # rows
_MOVES: Final = 4.0  # standard deviations from one row to the next
LEAST_NOISE: Final = 1.0e-6  # of the range: what is not searched more closely
_LOST: Final = 2.0e-4  # of what all rows tell along one direction of the unknowns, by one block
_SEEN: Final = 1.0e-12  # of the largest eigenvalue: below it a direction is not seen at all


def in_parts(model: StemModel, rests: Restarts, spacing: int) -> StemModel:
    """Return the model that begins anew at each ``spacing``-th rest; some parts from all over where there are many."""
    chosen = np.arange(0, rests.row.size, spacing)
    row, position_m = rests.row[chosen], rests.position_m[chosen]
    parts = max(_FEWEST_PARTS, _MOST_RESTS // spacing)
    if row.size <= parts:
        return replace(model, restarts=Restarts(row, position_m))
    taken = np.unique(np.linspace(0, row.size - 1, parts).astype(np.int64))
    ends = np.append(row[1:], model.time_s.size)
    kept = np.zeros(model.time_s.size, dtype=np.bool_)
    kept[: row[0]] = True
    for first, last in zip(row[taken], ends[taken], strict=True):
        kept[first:last] = True
    # a section whose rows are left out begins at the next row that is not, and ends there
    place = np.concatenate([[0], np.cumsum(kept)])
    return replace(
        model,
        time_s=np.ascontiguousarray(model.time_s[kept]),
        position_m=np.ascontiguousarray(model.position_m[kept]),
        weight=np.ascontiguousarray(model.weight[kept]),
        section_row=place[model.section_row],
        restarts=Restarts(place[row[taken]], position_m[taken]),
        events=max(1, model.events * taken.size * spacing // max(1, rests.row.size)),
    )


def compressed(
    model: StemModel,
    *,
    least_noise: float = LEAST_NOISE,
    keeping: FloatArray | None = None,
    longest_s: float = math.inf,
) -> StemModel:
    """Return the model of the means of blocks within which the measured position is straight.

    A block of n rows has the weight sqrt(n) of one: on a straight line its mean tells as much of the level there as
    all its rows. Transients keep their rows as far as the noise allows to see them bend; a position without noise
    is searched as if it had ``least_noise`` of its range, for its bottom is reached on all rows.
    What the noise hides of one corner, all corners together may show: with a point ``keeping``, shape (p,), the blocks
    are halved until they tell what all rows tell of the unknowns there. None is longer than ``longest_s``.
    """
    if model.time_s.size < 2:
        return model
    weight, edges = _blocks(model, least_noise, longest_s)
    if keeping is not None:
        edges = _informed(model, keeping, weight, edges)
    first = edges[:-1]
    share = np.add.reduceat(weight * weight, first)
    held = np.where(share > 0.0, share, 1.0)
    restarts = model.restarts
    if restarts is not None:
        restarts = Restarts(np.searchsorted(first, restarts.row).astype(np.int64), restarts.position_m)
    time_s = _mean(weight, model.time_s, first, held)
    off_s = model.time_s - np.repeat(time_s, np.diff(edges))
    return replace(
        model,
        time_s=time_s,
        block_s=np.sqrt(_mean(weight, off_s * off_s, first, held)),
        position_m=_mean(weight, model.position_m, first, held),
        weight=np.sqrt(share),
        section_row=np.searchsorted(first, model.section_row).astype(np.int64),
        restarts=restarts,
    )


def without_outliers(model: StemModel, point: FloatArray) -> StemModel:
    """Return the model without the parts that are far worse than most at this point (p,); whole motions as they are.

    The noise of the rest that a part begins anew at may add a jump at its end or take one off, which counts more than
    all other parts together, at the true valve too.
    """
    residual = None if model.restarts is None else model.residuals(point)
    if model.restarts is None or residual is None:
        return model
    edges = np.unique(np.concatenate([[0], model.restarts.row, [model.time_s.size]]))
    rows = np.diff(edges)
    mean = np.add.reduceat(residual * residual, edges[:-1]) / rows
    limit = max(_OUTLYING * float(np.median(mean)), float(np.quantile(mean, 1.0 - _MOST_OUTLYING)))
    return replace(model, weight=np.where(np.repeat(mean > limit, rows), 0.0, model.weight))


def bent_rows(simulated_m: FloatArray, weight: FloatArray) -> BoolArray:
    """Rows, shape (n,), about which the simulated position bends by more than a share of the noise."""
    bends = np.zeros(simulated_m.size, dtype=np.bool_)
    second = np.abs(np.diff(simulated_m, 2)) * weight[1:-1]
    for row in np.flatnonzero(second > _BENT):
        bends[max(0, row + 1 - _ABOUT) : row + 2 + _ABOUT] = True
    return bends


def _blocks(model: StemModel, least_noise: float, longest_s: float) -> tuple[FloatArray, IntArray]:
    """Weights of the rows, shape (n,), and edges of the blocks, shape (k + 1,)."""
    weight = np.minimum(model.weight, 1.0 / (least_noise * model.range_m))
    rows = model.section_row if model.restarts is None else np.concatenate([model.section_row, model.restarts.row])
    longest = max(_FEWEST_LONGEST, int(model.time_s.size * _LONGEST_SHARE))
    step_s = np.diff(model.time_s)
    if math.isfinite(longest_s):
        longest = max(1, min(longest, int(longest_s / float(np.median(step_s)))))
    gaps = np.flatnonzero(step_s > 2.0 * float(np.median(step_s))) + 1
    cut = np.unique(np.concatenate([rows, rows + 1, gaps])).astype(np.int64)
    if model.stepped:
        # rows at one phase of their treads: their mean is not the position at their mean time
        moving = np.flatnonzero(np.abs(np.diff(model.position_m)) * weight[1:] > _MOVES)
        cut = np.unique(np.concatenate([cut, moving, moving + 1]))
    cut = cut[cut < model.time_s.size]
    edges = np.array([0, model.time_s.size])
    for limit in _LIMITS:
        edges = straight_blocks(model.time_s, model.position_m, weight, cut, limit, longest)
        if math.isfinite(longest_s) or edges.size <= max(_MOST_BLOCKS, _BLOCKS_AN_EVENT * model.events):
            break
    return weight, edges


def _informed(model: StemModel, point: FloatArray, weight: FloatArray, edges: IntArray) -> IntArray:
    """Edges with every block halved that loses more than its share of the information at ``point``, shape (p,).

    With the slopes scaled to unit information, rows q, a block keeps (sum w q)^2 / sum w^2 of its sum of q^2.
    """
    slopes = model.slopes(point, one_sided=True)
    if slopes is None or model.spread is not None:
        return edges
    slopes *= np.divide(weight, model.weight, out=np.zeros_like(weight), where=model.weight > 0.0)
    size = np.sqrt(np.einsum("ij,ij->i", slopes, slopes) + model.coordinates.prior_weight)
    size[size == 0.0] = 1.0
    slopes /= size[:, None]
    normal = slopes @ slopes.T + np.diag(model.coordinates.prior_weight / size**2)
    values, directions = np.linalg.eigh(normal)
    is_seen = values > _SEEN * values[-1]
    unit = (directions[:, is_seen] / np.sqrt(values[is_seen])).T @ slopes
    sums = np.concatenate([unit * weight, np.stack([np.einsum("ij,ij->j", unit, unit), weight * weight])])
    sums = np.concatenate([np.zeros((sums.shape[0], 1)), np.cumsum(sums, axis=1)], axis=1)
    while True:
        own = np.diff(sums[:, edges], axis=1)
        kept = np.square(own[:-2]).sum(axis=0) / np.where(own[-1] > 0.0, own[-1], 1.0)
        lossy = np.flatnonzero((own[-2] - kept > _LOST) & (np.diff(edges) > 1))
        if lossy.size == 0:
            return edges
        edges = np.union1d(edges, (edges[lossy] + edges[lossy + 1]) // 2)


def _mean(weight: FloatArray, value: FloatArray, first: IntArray, share: FloatArray) -> FloatArray:
    return np.ascontiguousarray(np.add.reduceat(weight * weight * value, first) / share)
