"""A measured pressure whose corners an I/P has rounded: straight lines and steps behind one first-order lag.

    P(t) = level + slope t' + swing exp(-t'/T) + sum_j [ c_j G(t - t_j) + d_j S(t - t_j) ]
    S(t) = 1 - exp(-t/T),  G(t) = t - T S(t)  for t > 0, and 0 before;  t' = t - first time

c_j are changes of slope and d_j steps of what the lag follows. Far fewer numbers than a free curve, so far better
known; taken only where they leave no more than white noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.lag_kernel import lagged
from estimators.likelihood.piece_kernel import fitted, merged, refined
from estimators.samples import BoolArray, FloatArray, IntArray

# Own choices, tried on triangles, multi-rate triangles and steps behind lags of 0.02 to 1 s at 1-50 ms.
_MOST_ROWS: Final = 3500  # of the search for the events
_LAGS: Final = 8
_LONGEST_LAG_S: Final = 3.0
_MOST_EVENTS: Final = 100
_CLOSER: Final = 6  # times that the lag of the search is brought closer
_BLOCKS_A_LAG: Final = 10.0
_BLOCKS_A_LINE: Final = 16
_LAGS_OF_TRANSIENT: Final = 6.0
_ROUNDS: Final = 15
_PRUNINGS: Final = 16
_HOPELESS: Final = 1.5  # times the cost without a lag
_TRIFLE: Final = 1.0e-13
_LEAST_SIGMAS: Final = 4.5  # of its error: an event that is smaller is none
_SETTLED: Final = 0.01  # of the standard errors
_CHI_SIGMAS: Final = 5.0
_HOPELESS_SIGMAS: Final = 60.0  # before the events have settled
_LEAST_SIZES: Final = (0.3, 0.05, 0.0)  # of the largest event's
_PRICE: Final = 1.3
_CHORD_ERROR: Final = 2.0e-7  # of the span


@dataclass(frozen=True, slots=True, eq=False)
class LaggedLines:
    """The fitted model: ``parameters`` (p,) and their changes by one sigma along independent directions, (d, p).

    Parameters: level, slope, swing, lag, then times (e,), changes of slope (e,), steps (s,); ``steps``, shape (e,),
    says which events are steps.
    """

    first_s: float
    last_s: float
    parameters: FloatArray
    root: FloatArray
    steps: BoolArray
    tolerance: float

    @property
    def lag_s(self) -> float:
        """The fitted lag, s."""
        return float(self.parameters[3])

    @property
    def directions(self) -> int:
        """Number of independent directions in which it is uncertain."""
        return int(self.root.shape[0])

    def sizes(self) -> FloatArray:
        """Largest change of value along each direction, shape (d,)."""
        wanted_s = np.linspace(self.first_s, self.last_s, 200)
        plain = np.interp(wanted_s, *self.corners())
        changes = [np.interp(wanted_s, *self.corners(i)) - plain for i in range(self.directions)]
        return np.array([float(np.abs(change).max()) for change in changes])

    def corners(self, direction: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Corner times and values; changed by one sigma along a direction if it is given."""
        values = self.parameters if direction is None else self.parameters + self.root[direction]
        level, slope, swing, lag_s = (float(value) for value in values[:4])
        count = self.steps.size
        order = np.argsort(values[4 : 4 + count], kind="stable")
        event_s = np.clip(values[4 : 4 + count][order], self.first_s, self.last_s)
        bend = values[4 + count : 4 + 2 * count][order]
        step = np.zeros(count)
        step[self.steps] = values[4 + 2 * count :]
        step = step[order]
        # what the lag follows: a line that changes slope and steps; level + slope t' is its steady answer
        time_s = np.concatenate([[self.first_s], np.repeat(event_s, 2), [self.last_s]])
        slopes = slope + np.concatenate([[0.0], np.cumsum(bend)])
        rises = slopes * np.diff(np.concatenate([[self.first_s], event_s, [self.last_s]]))
        before = level + slope * lag_s + np.cumsum(rises) + np.concatenate([[0.0], np.cumsum(step)])
        after = before[:-1] + step
        target = np.concatenate([[level + slope * lag_s], np.column_stack([before[:-1], after]).ravel(), before[-1:]])
        return lagged(time_s, target, level + swing, lag_s, self.tolerance)


def lagged_lines(time_s: FloatArray, value: FloatArray, noise: float) -> LaggedLines | None:
    """Return the lines behind a lag that leave these rows white noise of this size, shape (n,), or None."""
    found = _search(time_s, value, noise)
    if found is None:
        return None
    lag_s, event_s, start, steps, size = found
    # a lag that is a little off makes small events of its own: first without these
    for least in _LEAST_SIZES:
        large = size >= least * float(size.max())
        fit = _with_events(time_s, value, noise, np.concatenate([start[:3], [lag_s], event_s[large]]), steps[large])
        if fit is not None:
            return fit
    return None


def _with_events(
    time_s: FloatArray, value: FloatArray, noise: float, start: FloatArray, steps: BoolArray
) -> LaggedLines | None:
    """Fit from these events and drop those that are not certain; None where more than noise is left."""
    parameters = np.concatenate([start, np.zeros(steps.size), np.zeros(int(steps.sum()))])
    settled = False
    for _ in range(_PRUNINGS):
        # anew each time: the blocks have to end at the events, and these move
        blocks = _blocks(time_s, value, np.sort(parameters[4 : 4 + steps.size]), float(parameters[3]))
        weight = np.sqrt(blocks.rows) / noise
        fit = _descended(blocks, _linear_solved(blocks, parameters, steps, weight), steps, weight)
        if fit is None:
            return None
        parameters, inverse, squares = fit
        free = weight.size - parameters.size
        if free < 1 or squares > free + (_HOPELESS_SIGMAS if not settled else _CHI_SIGMAS) * math.sqrt(2.0 * free):
            return None
        kept = _kept(parameters, inverse, steps)
        if settled and kept.all():
            break
        settled = bool(kept.all())
        parameters, steps = _without(parameters, steps, kept)
    else:
        return None
    variances, directions = np.linalg.eigh(inverse)
    root = (directions * np.sqrt(np.clip(variances, 0.0, None))).T
    error = max(_CHORD_ERROR * float(np.ptp(value)), 0.1 * noise * math.sqrt(parameters.size / time_s.size))
    return LaggedLines(float(time_s[0]), float(time_s[-1]), parameters, root, steps, error)


def _kept(parameters: FloatArray, inverse: FloatArray, steps: BoolArray) -> BoolArray:
    """All events, shape (e,), but the least certain one where it is too uncertain; two close ones hide each other."""
    count = steps.size
    sigmas = np.abs(parameters) / np.sqrt(np.maximum(np.diag(inverse), 1.0e-300))
    sure = sigmas[4 + count : 4 + 2 * count].copy()
    sure[steps] = np.maximum(sure[steps], sigmas[4 + 2 * count :])
    kept = np.ones(count, dtype=np.bool_)
    if count > 0 and float(sure.min()) < _LEAST_SIGMAS:
        kept[int(sure.argmin())] = False
    return kept


def _without(parameters: FloatArray, steps: BoolArray, kept: BoolArray) -> tuple[FloatArray, BoolArray]:
    count = steps.size
    parts = [parameters[:4], parameters[4 : 4 + count][kept], parameters[4 + count : 4 + 2 * count][kept]]
    return np.concatenate([*parts, parameters[4 + 2 * count :][kept[steps]]]), steps[kept]


def _search(
    time_s: FloatArray, value: FloatArray, noise: float
) -> tuple[float, FloatArray, FloatArray, BoolArray, FloatArray] | None:
    """Lag, event times, first coefficients, which events are steps, and their sizes: the cheapest of some lags."""
    rows = max(1, time_s.size // _MOST_ROWS)
    count = time_s.size // rows
    coarse_s = time_s[: count * rows].reshape(count, rows).mean(axis=1)
    coarse = value[: count * rows].reshape(count, rows).mean(axis=1)
    weight, price = rows / noise**2, _PRICE * math.log(max(count, 8))
    longest = max(64, count // 50)

    def cut(lag_s: float, *, fully: bool = True) -> tuple[float, IntArray]:
        edges = merged(coarse_s, coarse, 3, weight, price, lag_s)
        if fully:
            edges = refined(coarse_s, coarse, edges, 10, 3, longest, weight, price, lag_s)
        factors, degree = fitted(coarse_s, coarse, edges, weight, price, lag_s)
        left = sum(float(np.sum(f[d + 1 :, 4] ** 2)) for f, d in zip(factors, degree, strict=True))
        return weight * left + price * float(np.sum(degree + 2)), edges

    shortest_s = max(2.0 * float(coarse_s[1] - coarse_s[0]), 0.01)
    tried = [
        (*cut(float(lag_s), fully=False), float(lag_s)) for lag_s in np.geomspace(shortest_s, _LONGEST_LAG_S, _LAGS)
    ]
    cost, edges, lag_s = min(tried, key=lambda trial: trial[0])
    if cost > _HOPELESS * cut(0.0, fully=False)[0]:
        return None
    cost, edges = cut(lag_s)
    ratio = (_LONGEST_LAG_S / shortest_s) ** (1.0 / (_LAGS - 1))
    for _ in range(_CLOSER):
        ratio = math.sqrt(ratio)
        near = [(cost, edges, lag_s)] + [(*cut(other_s), other_s) for other_s in (lag_s / ratio, lag_s * ratio)]
        cost, edges, lag_s = min(near, key=lambda trial: trial[0])
    if cost >= cut(0.0)[0] or not 0 < edges.size - 2 <= _MOST_EVENTS:
        return None
    factors, _ = fitted(coarse_s, coarse, edges, weight, price, lag_s)
    return lag_s, *_events(coarse_s, edges, factors, lag_s)


def _events(
    time_s: FloatArray, edges: IntArray, factors: FloatArray, lag_s: float
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray]:
    """Times of the events, level, slope and swing at the start, which events are steps, and sizes as pressures."""
    first_s, last_s = time_s[edges[:-1]], time_s[edges[1:] - 1]
    centre_s, half_s = 0.5 * (first_s + last_s), 0.5 * (last_s - first_s)
    lines = np.array([np.linalg.pinv(factor[:3, :3]) @ factor[:3, 4] for factor in factors])
    slope = lines[:, 1] / half_s
    at_s = 0.5 * (first_s[1:] + last_s[:-1])
    # what the lag follows is its steady answer, earlier by the lag
    one = lines[:-1, 0] + slope[:-1] * (at_s - centre_s[:-1] + lag_s)
    two = lines[1:, 0] + slope[1:] * (at_s - centre_s[1:] + lag_s)
    bend, jump = slope[1:] - slope[:-1], two - one
    steps = np.abs(jump) > np.abs(bend) * max(lag_s, 10.0 * float(time_s[1] - time_s[0]))
    start = np.array([lines[0, 0] + slope[0] * (time_s[0] - centre_s[0]), slope[0], lines[0, 2]])
    return at_s, start, np.asarray(steps, dtype=np.bool_), np.abs(bend) * lag_s + np.where(steps, np.abs(jump), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Means of some rows each: their times and values, how many rows, and half the time that they cover."""

    start_s: float
    time_s: FloatArray
    value: FloatArray
    rows: FloatArray
    half_s: FloatArray


def _blocks(time_s: FloatArray, value: FloatArray, event_s: FloatArray, lag_s: float) -> _Blocks:
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
    return _Blocks(float(time_s[0]), means_s, means, rows, np.where(rows > 1.0, half_s, 0.0))


def _model(blocks: _Blocks, parameters: FloatArray, steps: BoolArray) -> tuple[FloatArray, FloatArray]:
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


def _descended(
    blocks: _Blocks, parameters: FloatArray, steps: BoolArray, weight: FloatArray
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


def _linear_solved(blocks: _Blocks, parameters: FloatArray, steps: BoolArray, weight: FloatArray) -> FloatArray:
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
    blocks: _Blocks, parameters: FloatArray, steps: BoolArray, linear: FloatArray, weight: FloatArray
) -> FloatArray:
    coefficients = np.concatenate([parameters[:3], parameters[4 + steps.size :]])
    return np.asarray((blocks.value - linear @ coefficients) * weight)
