"""Travel stops, as the stem shows them: it is held where the force goes on driving it, and turns back from there.

The end of such a motion is the stop's and not the friction's, so it is left out. The way back begins as from any rest:
a stop only pushes one way, and holds no stem whose force has turned.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.engine.reading import Reading
from estimators.engine.segmentation import Move

_EARLY_S: Final = 0.01  # a corner so shortly after the arrival may have been before it: filters are late
_DRIVEN: Final = 3.0  # bands of the position, by which the force goes on
_BEFORE_S: Final = 0.05  # the sensor's filter has rounded the arrival
_BANDS_BEFORE: Final = 2.0
_SURELY: Final = 1.1  # times F_s: friction alone does not hold so much
_SCATTERS: Final = 4.0


def ends_driven(reading: Reading, move: Move) -> bool:
    """Whether the force still drove the stem on when it came to rest, and it then turned back or the record ended."""
    if move.next_rest < 0 or reading.spring_n_per_m <= 0.0:
        return False
    rest, time_s = reading.segmentation.rests[move.next_rest], reading.time_s
    following = [one for one in reading.segmentation.moves if one.rest == move.next_rest]
    if following and following[0].direction == move.direction:
        return False  # it slipped
    arrived_s, corners_s = time_s[rest.first], reading.path.corners_s
    if ((corners_s > time_s[move.first]) & (corners_s < arrived_s + _EARLY_S)).any():
        return False
    force_n = move.direction * reading.path.force_n[rest.first : rest.last + 1]
    return bool(force_n.max() - force_n[0] > _DRIVEN * reading.segmentation.band_m * reading.spring_n_per_m)


def last_row_before_stop(reading: Reading, move: Move) -> int:
    """The last row of a move of which a stop has changed nothing yet."""
    rest, position_m = reading.segmentation.rests[move.next_rest], reading.position_m
    far_m = move.direction * (rest.level_m - position_m[move.first : rest.first + 1])
    near = np.flatnonzero(far_m > _BANDS_BEFORE * reading.segmentation.band_m)
    row = move.first + (int(near[-1]) if near.size else 0)
    return int(np.searchsorted(reading.time_s, reading.time_s[row] - _BEFORE_S))


def ran_into_a_stop(reading: Reading, spring: float, preload_n: float, static_n: tuple[float, float]) -> bool:
    """Whether a stem was held against more force than its friction takes; ``static_n``: F_s and its scatter, N."""
    most_n = _SURELY * static_n[0] + _SCATTERS * static_n[1]
    for move in reading.segmentation.moves:
        if not ends_driven(reading, move):
            continue
        rest = reading.segmentation.rests[move.next_rest]
        force_n = reading.path.force_n[rest.first : rest.last + 1] - spring * rest.level_m - preload_n
        if float((move.direction * force_n).max()) > most_n:
            return True
    return False
