"""A measured pressure whose corners an I/P has rounded: straight lines and steps behind one first-order lag.

    P(t) = level + slope t' + swing exp(-t'/T) + sum_j [ c_j G(t - t_j) + d_j S(t - t_j) ]
    S(t) = 1 - exp(-t/T),  G(t) = t - T S(t)  for t > 0, and 0 before;  t' = t - first time

c_j are changes of slope and d_j steps of what the lag follows. Far fewer numbers than a free curve, so far better
known; taken only where they leave no more than white noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.lines.lag_blocks import blocks_of, descended, linear_solved
from estimators.likelihood.lines.lag_events import search_events
from estimators.motion.lagged_lines import lagged
from estimators.samples import BoolArray, FloatArray

# Own choices, tried on triangles, multi-rate triangles and steps behind lags of 0.02 to 1 s at 1-50 ms.
_PRUNINGS: Final = 16
_LEAST_SIGMAS: Final = 4.5  # of its error: an event that is smaller is none
_SURE_LAG: Final = 4.0  # of its errors: a shorter one may be none, and lines that meet sharply say it better
_CHI_SIGMAS: Final = 5.0
_HOPELESS_SIGMAS: Final = 60.0  # before the events have settled
_LEAST_SIZES: Final = (0.3, 0.05, 0.0)  # of the largest event's
_SOME_LAGS_S: Final = (0.03, 0.1, 0.3, 0.01, 0.7)
_TURNS_BY: Final = 8.0  # times the noise, and
_TURNS_OF_SPAN: Final = 0.02
_TURN_ROWS: Final = 6000  # means
_MOST_TURNS: Final = 80
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
    found = search_events(time_s, value, noise)
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


def lines_behind_some_lag(time_s: FloatArray, value: FloatArray, noise: float) -> LaggedLines | None:
    """Return the lines behind a lag, between the turns of a signal that goes to and fro, or None; as ``lagged_lines``.

    The search for the events takes a rounding that hides in the noise of each corner for none, and a curve that many
    fast ramps make for many small events. What goes up and down turns once between: ln 2 lags late.
    """
    turn_s = _turns(time_s, value, noise)
    if not 0 < turn_s.size <= _MOST_TURNS:
        return None
    steps = np.zeros(turn_s.size, dtype=np.bool_)
    for lag_s in _SOME_LAGS_S:
        event_s = np.concatenate([turn_s[:1], turn_s[1:] - lag_s * math.log(2.0)])
        fit = _with_events(time_s, value, noise, np.concatenate([np.zeros(3), [lag_s], event_s]), steps)
        if fit is not None:
            return fit
    return None


def _turns(time_s: FloatArray, value: FloatArray, noise: float) -> FloatArray:
    """Times, s, shape (e,), at which the signal leaves its first value, and turns by far more than the noise."""
    # means of rows, whose noise is a small part of what counts as a turn
    least = max(_TURNS_BY * noise, _TURNS_OF_SPAN * float(np.ptp(value)))
    rows = max(1, time_s.size // _TURN_ROWS)
    count = time_s.size // rows
    own_s = time_s[: count * rows].reshape(count, rows).mean(axis=1)
    own = value[: count * rows].reshape(count, rows).mean(axis=1)
    begun = np.flatnonzero(np.abs(own - own[0]) > least)
    if begun.size == 0:
        return np.empty(0)
    found, sense, far = [float(own_s[max(begun[0] - 1, 0)])], float(np.sign(own[begun[0]] - own[0])), int(begun[0])
    for row in range(far, count):
        if sense * (own[row] - own[far]) > 0.0:
            far = row
        elif sense * (own[far] - own[row]) > least:
            found.append(float(own_s[far]))
            sense, far = -sense, row
    return np.array(found)


def _with_events(
    time_s: FloatArray, value: FloatArray, noise: float, start: FloatArray, steps: BoolArray
) -> LaggedLines | None:
    """Fit from these events and drop those that are not certain; None where more than noise is left."""
    parameters = np.concatenate([start, np.zeros(steps.size), np.zeros(int(steps.sum()))])
    settled = False
    for _ in range(_PRUNINGS):
        # anew each time: the blocks have to end at the events, and these move
        blocks = blocks_of(time_s, value, np.sort(parameters[4 : 4 + steps.size]), float(parameters[3]))
        weight = np.sqrt(blocks.rows) / noise
        fit = descended(blocks, linear_solved(blocks, parameters, steps, weight), steps, weight)
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
    if not float(parameters[3]) > _SURE_LAG * math.sqrt(float(inverse[3, 3])):
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
