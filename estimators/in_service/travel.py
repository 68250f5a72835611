"""How much a valve in service moves: total travel, cycles, and where it stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.compiled import kernel_of
from estimators.in_service.moves import IntArray, Moves
from estimators.in_service.rows import Rows
from valve.recording import FloatArray

_BINS: Final = 10

_kernel = kernel_of(__file__)


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """Figures in the position's unit, of moves beyond the noise.

    ``cycles`` are changes of direction, as positioners count them. ``edges``, shape (11,), and ``shares`` of the time,
    shape (10,): the histogram.
    """

    total: float
    total_ci95: tuple[float, float]
    per_hour: float
    moves: int
    cycles: int
    lowest: float
    highest: float
    mean: float
    edges: FloatArray
    shares: FloatArray


def travel_of(rows: Rows, moves: Moves, travel: float | None) -> Travel:
    """Return the travel's figures; bins are tenths of the travel, or of what was seen where it is not known.

    Moves go from rest to rest. A stem that never rests is followed from turn to turn.
    """
    total, count = float(np.abs(moves.to_level - moves.from_level).sum()), moves.count
    turned = int(np.count_nonzero(moves.began[1:] != moves.ended[:-1]) + np.count_nonzero(moves.began != moves.ended))
    if count < 2:
        total, count = _turns(rows.position, rows.run, moves.band)
        turned = count - 1 if count else 0
    half = 1.96 * rows.noise * float(np.sqrt(2.0 * max(count, 1)))
    steps_s = np.append(np.diff(rows.time_s), 0.0)
    steps_s[np.append(np.diff(rows.run) != 0, False)] = 0.0
    low, high = float(rows.position.min()), float(rows.position.max())
    first, last = (0.0, travel) if travel is not None else (low, high if high > low else low + 1.0)
    edges = np.linspace(first, last, _BINS + 1)
    weights, _ = np.histogram(np.clip(rows.position, first, last), edges, weights=steps_s)
    return Travel(
        total,
        (max(total - half, 0.0), total + half),
        total * 3600.0 / rows.covered_s,
        count,
        turned,
        low,
        high,
        float(np.average(rows.position, weights=steps_s)),
        edges,
        np.asarray(weights / max(float(weights.sum()), 1.0e-300)),
    )


@_kernel
def _turns(position: FloatArray, run: IntArray, band: float) -> tuple[float, int]:
    """Way from turn to turn, and the number of these ways; a turn goes back by more than the band."""
    total, ways = 0.0, 0
    from_level = extreme = position[0]
    direction = 0
    for row in range(1, position.size):
        value = position[row]
        if run[row] != run[row - 1]:
            if direction != 0:
                total, ways = total + abs(extreme - from_level), ways + 1
            from_level, extreme, direction = value, value, 0
            continue
        if direction == 0:
            if abs(value - from_level) > band:
                direction, extreme = (1 if value > from_level else -1), value
        elif (value - extreme) * direction > 0.0:
            extreme = value
        elif (extreme - value) * direction > band:
            total, ways = total + abs(extreme - from_level), ways + 1
            from_level, extreme, direction = extreme, value, -direction
    if direction != 0:
        total, ways = total + abs(extreme - from_level), ways + 1
    return total, ways
