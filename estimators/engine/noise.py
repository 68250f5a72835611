"""The position's noise, read off where the stem rests: white, and coloured as an Ornstein-Uhlenbeck process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.segmentation import Rest

FloatArray = npt.NDArray[np.float64]

_TIMES_S: Final = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
_REACH_S: Final = 0.3
_MOST_LAGS: Final = 60
_LEAST_COLOURED: Final = 0.003  # of the white variance: less changes nothing
_INSIDE: Final = 0.15  # of a rest at either end may belong to the motion beside it
_FEWEST: Final = 30


@dataclass(frozen=True, slots=True)
class PositionNoise:
    """Standard deviations of a row's white noise and of the coloured one, m, and the time of the latter, s."""

    white_m: float
    coloured_m: float
    coloured_s: float


def position_noise_at_rest(
    time_s: FloatArray, position_m: FloatArray, rests: tuple[Rest, ...], white_m: float, least_m: float
) -> PositionNoise:
    """Return the noise by the autocovariance at the rests; ``white_m`` is taken where there are too few rows.

    A converter shows no noise at a rest that is quieter than its step, and a computed position none anywhere: the
    noise is at least ``least_m``. ``time_s``, ``position_m``: shape (n,).
    """
    period_s = float(np.median(np.diff(time_s)))
    lags = min(_MOST_LAGS, max(2, round(_REACH_S / period_s)))
    numbers = np.unique(np.round(np.geomspace(1, max(2, round(_REACH_S / period_s)), lags)).astype(int))
    sums, counts = np.zeros(numbers.size + 1), np.zeros(numbers.size + 1)
    for rest in rests:
        margin = round(_INSIDE * (rest.last - rest.first)) + 1
        part = position_m[rest.first + margin : rest.last - margin + 1]
        if part.size < _FEWEST:
            continue
        away = part - part.mean()
        for at, lag in enumerate([0, *numbers.tolist()]):
            if lag < part.size // 3:
                sums[at] += float(away[lag:] @ away[: away.size - lag])
                counts[at] += away.size - lag
    if counts[0] < 4 * _FEWEST:
        return PositionNoise(max(white_m, least_m), 0.0, _TIMES_S[0])
    known = counts[1:] > 0
    total = float(sums[0] / counts[0])
    covariance, lag_s, weight = sums[1:][known] / counts[1:][known], numbers[known] * period_s, counts[1:][known]
    best = (np.inf, 0.0, _TIMES_S[0])
    for time_s_ in _TIMES_S:
        if time_s_ < 0.7 * period_s or lag_s.size == 0:
            continue
        shape = np.exp(-lag_s / time_s_)
        size = max(0.0, float((weight * shape) @ covariance / ((weight * shape) @ shape)))
        cost = float(weight @ (covariance - size * shape) ** 2)
        if cost < best[0]:
            best = (cost, size, time_s_)
    coloured = min(best[1], 0.98 * total)
    white = max(total - coloured, 0.02 * total, least_m**2)
    if coloured < _LEAST_COLOURED * white:
        coloured = 0.0
    return PositionNoise(float(np.sqrt(white)), float(np.sqrt(coloured)), best[2])
