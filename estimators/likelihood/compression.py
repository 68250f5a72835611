"""The rows of a recording as few blocks, for the search: a stem at rest or in uniform motion needs hardly any."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.block_kernel import straight_blocks
from estimators.likelihood.model import Restarts, StemModel
from estimators.samples import BoolArray, FloatArray, IntArray

# Own choices: what joining two lines may add to the squares (2 in the mean), and the longest block as a share of all.
_LIMITS: Final = (9.0, 25.0, 100.0)
_LONGEST_SHARE: Final = 1.0 / 150.0
_FEWEST_LONGEST: Final = 8
_MOST_RESTS: Final = 96
_FEWEST_PARTS: Final = 4
_MOST_BLOCKS: Final = 3000
_BLOCKS_AN_EVENT: Final = 4
_BENT: Final = 0.1  # of the noise, from one row to the next
_ABOUT: Final = 3  # rows
_MOVES: Final = 4.0  # standard deviations from one row to the next
LEAST_NOISE: Final = 1.0e-6  # of the range: what is not searched more closely


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


def compressed(model: StemModel, *, least_noise: float = LEAST_NOISE) -> StemModel:
    """Return the model of the means of blocks within which the measured position is straight.

    A block of n rows has the weight sqrt(n) of one: on a straight line its mean tells as much of the level there as
    all its rows. Transients keep their rows as far as the noise allows to see them bend; a position without noise
    is searched as if it had ``least_noise`` of its range, for its bottom is reached on all rows.
    """
    if model.time_s.size < 2:
        return model
    weight, edges = _blocks(model, least_noise)
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


def bent_rows(simulated_m: FloatArray, weight: FloatArray) -> BoolArray:
    """Rows, shape (n,), about which the simulated position bends by more than a share of the noise."""
    bends = np.zeros(simulated_m.size, dtype=np.bool_)
    second = np.abs(np.diff(simulated_m, 2)) * weight[1:-1]
    for row in np.flatnonzero(second > _BENT):
        bends[max(0, row + 1 - _ABOUT) : row + 2 + _ABOUT] = True
    return bends


def _blocks(model: StemModel, least_noise: float) -> tuple[FloatArray, IntArray]:
    """Weights of the rows, shape (n,), and edges of the blocks, shape (k + 1,)."""
    weight = np.minimum(model.weight, 1.0 / (least_noise * model.range_m))
    rows = model.section_row if model.restarts is None else np.concatenate([model.section_row, model.restarts.row])
    longest = max(_FEWEST_LONGEST, int(model.time_s.size * _LONGEST_SHARE))
    step_s = np.diff(model.time_s)
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
        if edges.size <= max(_MOST_BLOCKS, _BLOCKS_AN_EVENT * model.events):
            break
    return weight, edges


def _mean(weight: FloatArray, value: FloatArray, first: IntArray, share: FloatArray) -> FloatArray:
    return np.ascontiguousarray(np.add.reduceat(weight * weight * value, first) / share)
