"""Lines and steps behind a first-order lag, fitted to means of rows: Gauss and Newton's steps for all parameters.

Parameters, shape (p,): level, slope, swing, lag, then times (e,), changes of slope (e,), steps (s,) of the events.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.samples import BoolArray, FloatArray

_BLOCKS_A_LAG: Final = 10.0
_BLOCKS_A_LINE: Final = 16
_LAGS_OF_TRANSIENT: Final = 6.0
_ROUNDS: Final = 15
_TRIFLE: Final = 1.0e-13
_SETTLED: Final = 0.01  # of the standard errors


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Means of some rows each: their times and values, how many rows, and half the time that they cover."""

    start_s: float
    time_s: FloatArray
    value: FloatArray
    rows: FloatArray
    half_s: FloatArray


def blocks_of(time_s: FloatArray, value: FloatArray, event_s: FloatArray, lag_s: float) -> Blocks:
    """Blocks far shorter than the lag after each event, and longer where it has died out."""
    ends_s = np.clip(np.concatenate([[time_s[0]], event_s, [time_s[-1]]]), time_s[0], time_s[-1])
    short_s = lag_s / _BLOCKS_A_LAG
    # single rows at the events, which fall between rows
    near_s = float(np.median(np.diff(time_s))) * np.arange(-2.0, 3.0)
    marks = [(ends_s[:, None] + near_s).ravel()]
    for begin_s, end_s in pairwise(ends_s.tolist()):
        # the event itself is not known better than to some blocks
        bent_s = min(begin_s + _LAGS_OF_TRANSIENT * lag_s, end_s)
        late_s = max(bent_s, end_s - lag_s)
        marks += [np.arange(begin_s, bent_s, short_s), np.linspace(bent_s, late_s, _BLOCKS_A_LINE, endpoint=False)]
        marks.append(np.arange(late_s, end_s, short_s))
    edges = np.unique(np.searchsorted(time_s, np.unique(np.concatenate(marks))))
    edges = edges[(edges > 0) & (edges < time_s.size)]
    edges = np.concatenate([[0], edges])
    rows = np.diff(np.concatenate([edges, [time_s.size]])).astype(np.float64)
    half_s = 0.5 * rows * float(np.median(np.diff(time_s)))
    means_s, means = np.add.reduceat(time_s, edges) / rows, np.add.reduceat(value, edges) / rows
    return Blocks(float(time_s[0]), means_s, means, rows, np.where(rows > 1.0, half_s, 0.0))


def _model(blocks: Blocks, parameters: FloatArray, steps: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Columns of the linear parameters, shape (n, 3 + e + s), and of lag and event times, shape (n, 1 + e)."""
    count = steps.size
    lag_s = float(parameters[3])
    bend = parameters[4 + count : 4 + 2 * count]
    step = np.zeros(count)
    step[steps] = parameters[4 + 2 * count :]
    from_start_s = blocks.time_s - blocks.start_s
    after_s = blocks.time_s[:, None] - parameters[4 : 4 + count]
    gone = after_s > 0.0
    after_s = np.where(gone, after_s, 0.0)
    # the mean of an exponential over a block is more than at its middle
    half = np.minimum(blocks.half_s / lag_s, 1.0)
    mean = 1.0 + half * half / 6.0 * (1.0 + half * half / 20.0)
    left = np.where(gone, np.exp(-after_s / lag_s), 0.0) * mean[:, None]
    risen = np.where(gone, 1.0 - left, 0.0)
    start_left = np.exp(-from_start_s / lag_s) * mean
    linear = np.column_stack(
        [np.ones(from_start_s.size), from_start_s, start_left, after_s - lag_s * risen, risen[:, steps]]
    )
    by_event = -bend * risen - step * left / lag_s
    by_lag = (
        float(parameters[2]) * start_left * from_start_s / lag_s**2
        + (-risen + left * after_s / lag_s) @ bend
        - (left * after_s / lag_s**2) @ step
    )
    return linear, np.column_stack([by_lag, by_event])


def descended(
    blocks: Blocks, parameters: FloatArray, steps: BoolArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, float] | None:
    """Parameters, their covariance (p, p) and the squares left, by Gauss-Newton steps."""
    count = steps.size
    at = np.concatenate([[0, 1, 2], np.arange(4 + count, parameters.size), [3], np.arange(4, 4 + count)])
    linear, nonlinear = _model(blocks, parameters, steps)
    left = _left(blocks, parameters, steps, linear, weight)
    covariance = np.zeros((parameters.size, parameters.size))
    for _ in range(_ROUNDS):
        columns = np.hstack([linear, nonlinear]) * weight[:, None]
        size = np.linalg.norm(columns, axis=0)
        if not size.all():
            return None
        columns /= size
        inverse = _inverse(columns.T @ columns)
        step = inverse @ (columns.T @ left)
        change = np.zeros(parameters.size)
        change[at] = step / size
        covariance[np.ix_(at, at)] = inverse / np.outer(size, size)
        settled = bool((np.abs(step) <= _SETTLED * np.sqrt(np.maximum(np.diag(inverse), 1.0e-300))).all())
        better = False
        for share in (1.0, 0.25, 0.06, 0.015):
            tried = parameters + share * change
            if tried[3] <= 0.2 * parameters[3]:
                continue
            tried_linear, tried_nonlinear = _model(blocks, tried, steps)
            tried_left = _left(blocks, tried, steps, tried_linear, weight)
            better = float(tried_left @ tried_left) < float(left @ left)
            if better:
                parameters, left, linear, nonlinear = tried, tried_left, tried_linear, tried_nonlinear
                break
        if settled or not better:
            break
    return parameters, covariance, float(left @ left)


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of a matrix with ones on its diagonal, to which a trifle is added: it may be singular."""
    return np.asarray(np.linalg.inv(normal + _TRIFLE * np.eye(normal.shape[0])))


def linear_solved(blocks: Blocks, parameters: FloatArray, steps: BoolArray, weight: FloatArray) -> FloatArray:
    """Parameters with the linear ones by least squares."""
    columns = _model(blocks, parameters, steps)[0] * weight[:, None]
    size = np.maximum(np.linalg.norm(columns, axis=0), 1.0e-300)
    columns /= size
    solution = _inverse(columns.T @ columns) @ (columns.T @ (blocks.value * weight))
    solution /= size
    solved = parameters.copy()
    solved[:3] = solution[:3]
    solved[4 + steps.size :] = solution[3:]
    return solved


def _left(
    blocks: Blocks, parameters: FloatArray, steps: BoolArray, linear: FloatArray, weight: FloatArray
) -> FloatArray:
    coefficients = np.concatenate([parameters[:3], parameters[4 + steps.size :]])
    return np.asarray((blocks.value - linear @ coefficients) * weight)
