"""A position that moves while the stem rests: it creeps or its reading wanders, and no cause is named beside that."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.reading import Reading
from valve.messages import Message, say

FloatArray = npt.NDArray[np.float64]

_SETTLED_S: Final = 0.3  # after its motion a stem, or a reading that lags, has come to rest
_BEFORE_S: Final = 0.05  # it sets off somewhere between rows
_BLOCK_S: Final = 0.1
_FEWEST_IN_REST: Final = 5  # blocks
_FEWEST: Final = 20
_SMOOTH: Final = 2.0  # times the scatter from block to block; coloured noise of healthy readings shows up to 1.3
_LEAST_DRIFT: Final = 3.0e-5  # of the travel a second


def moves_at_rest(reading: Reading) -> Message | None:
    """Return by how much the position moves while the stem rests; None where it stays.

    What a stem yields by follows the force and is taken off. What is left goes on from block to block of a tenth of a
    second, as no noise does (von Neumann's ratio).
    """
    blocks = _resting_blocks(reading)
    if blocks is None:
        return None
    rest, time_s, position_m, force_n = blocks
    yielded = float(position_m @ force_n) / max(float(force_n @ force_n), 1.0e-300)
    left_m = position_m - yielded * force_n
    beside = rest[1:] == rest[:-1]
    step_m2 = float(np.mean(np.diff(left_m)[beside] ** 2)) / 2.0
    free = left_m.size - np.unique(rest).size - 1
    if not float(left_m @ left_m) / free > _SMOOTH**2 * step_m2:
        return None
    drifts = [
        float(left_m[rest == one] @ time_s[rest == one]) / float(time_s[rest == one] @ time_s[rest == one])
        for one in np.unique(rest)
    ]
    drift_m_per_s = math.sqrt(float(np.mean(np.square(drifts))))
    if drift_m_per_s < _LEAST_DRIFT * reading.travel_m:
        return None
    return say(
        "reading_moves_at_rest",
        "The position moves by {drift:.2g um}/s while the stem rests: it creeps, or its reading wanders. Check the "
        "transmitter's mounting and zero, and repeat the test.",
        drift=drift_m_per_s,
    )


def _resting_blocks(reading: Reading) -> tuple[npt.NDArray[np.int64], FloatArray, FloatArray, FloatArray] | None:
    """Number of the rest, time (s), position (m) and force (N) of blocks, less each rest's mean; None if too few."""
    block_s = max(_BLOCK_S, reading.samples.period_s)
    numbers: list[FloatArray] = []
    parts: list[FloatArray] = []
    for number, rest in enumerate(reading.segmentation.rests):
        rows = slice(rest.first, rest.last + 1)
        time_s = reading.time_s[rows]
        inside = (time_s > time_s[0] + _SETTLED_S) & (time_s < time_s[-1] - _BEFORE_S)
        if not inside.any():
            continue
        block = np.floor((time_s[inside] - time_s[inside][0]) / block_s).astype(np.int64)
        _, of, counts = np.unique(block, return_inverse=True, return_counts=True)
        if counts.size < _FEWEST_IN_REST:
            continue
        means = np.array(
            [
                np.bincount(of, values[inside]) / counts
                for values in (time_s, reading.position_m[rows], reading.samples.force_n[rows])
            ]
        )
        parts.append(means - means.mean(axis=1, keepdims=True))
        numbers.append(np.full(counts.size, number))
    if sum(one.size for one in numbers) < _FEWEST:
        return None
    time_s, position_m, force_n = np.concatenate(parts, axis=1)
    return np.concatenate(numbers).astype(np.int64), time_s, position_m, force_n
