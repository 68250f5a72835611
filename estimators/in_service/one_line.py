"""Whether position against signal follows one line all the time: a unit, a range or a zero that changes gives two.

signal = c + k x + s F, s the direction of the motion, is fitted by least squares before and after each instant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.in_service.events import Observations
from valve.recording import FloatArray

# Own choices; a flow that changes its force on the plug slowly, or by less than the friction, is no change of units.
_FEWEST: Final = 10  # observations on either side
_BY_FRICTION: Final = 1.0  # times the friction: by so much the lines must differ
_BY_SCATTER: Final = 5.0  # times what is left about the lines
_ERRORS: Final = 8.0
_OUTLIER: Final = 4.5  # robust deviations


@dataclass(frozen=True, slots=True)
class NewLine:
    """Between which times another line began, s, by how much it differs, and the friction, in the signal's unit."""

    since_s: float
    until_s: float
    differs: float
    friction: float


def new_line(seen: Observations) -> NewLine | None:
    """Return where the observations change to another line for good; None where one line holds."""
    order = np.argsort(seen.time_s, kind="stable")
    time_s, signal = seen.time_s[order], seen.signal[order]
    columns = np.column_stack([np.ones(order.size), seen.position[order], seen.sign[order]])
    columns[:, 1] -= columns[:, 1].mean()
    if order.size < 2 * _FEWEST:
        return None
    splits = np.arange(_FEWEST, order.size - _FEWEST + 1)
    if splits.size > 200:
        splits = splits[np.linspace(0, splits.size - 1, 200).astype(np.int64)]
    left = [sum(_fitted(columns[part], signal[part])[2] for part in (slice(at), slice(at, None))) for at in splits]
    split = int(splits[int(np.argmin(left))])
    split = _refined(columns, signal, split)
    parts = [_usual(columns[part], signal[part]) for part in (slice(split), slice(split, None))]
    scatter = max(part[2] for part in parts)
    friction = float(np.median([abs(part[0][2]) for part in parts]))
    middles = [columns[part].mean(axis=0) for part in (slice(split), slice(split, None))]
    places = np.vstack([*middles, np.quantile(columns, [0.1, 0.9], axis=0)])
    places[:, 2] = 0.0
    apart = np.abs(places @ (parts[1][0] - parts[0][0]))
    variance = sum(part[1] * part[2] ** 2 for part in parts)
    error = np.sqrt(np.einsum("ij,jk,ik->i", places, variance, places))
    beyond = (apart > _ERRORS * error) & (apart > _BY_FRICTION * friction) & (apart > _BY_SCATTER * scatter)
    if not beyond.any():
        return None
    return NewLine(float(time_s[split - 1]), float(time_s[split]), float(apart[beyond].max()), friction)


def _refined(columns: FloatArray, signal: FloatArray, split: int) -> int:
    """Return the split near this one that leaves least, where not all were tried."""
    near = range(max(_FEWEST, split - 20), min(signal.size - _FEWEST, split + 20) + 1)
    return min(near, key=lambda at: sum(_fitted(columns[p], signal[p])[2] for p in (slice(at), slice(at, None))))


def _usual(columns: FloatArray, signal: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Values, covariance by unit variance, and robust deviation about the line, without the outliers."""
    left = np.abs(signal - columns @ _fitted(columns, signal)[0])
    near = left <= _OUTLIER * 1.4826 * float(np.median(left))
    values, inverse, _ = _fitted(columns[near], signal[near])
    left = np.abs(signal[near] - columns[near] @ values)
    return values, inverse, 1.4826 * float(np.median(left))


def _fitted(columns: FloatArray, signal: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Values, their covariance by unit variance, and the sum of squares that is left."""
    inner = columns.T @ columns
    inverse = np.asarray(np.linalg.pinv(inner), np.float64)
    values = inverse @ (columns.T @ signal)
    left = signal - columns @ values
    return values, inverse, float(left @ left)
