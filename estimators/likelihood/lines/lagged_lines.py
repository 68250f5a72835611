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
from estimators.likelihood.lines.lag_kernel import lagged
from estimators.samples import BoolArray, FloatArray

# Own choices, tried on triangles, multi-rate triangles and steps behind lags of 0.02 to 1 s at 1-50 ms.
_PRUNINGS: Final = 16
_LEAST_SIGMAS: Final = 4.5  # of its error: an event that is smaller is none
_SURE_LAG: Final = 4.0  # of its errors: a shorter one may be none, and lines that meet sharply say it better
_CHI_SIGMAS: Final = 5.0
_HOPELESS_SIGMAS: Final = 60.0  # before the events have settled
_LEAST_SIZES: Final = (0.3, 0.05, 0.0)  # of the largest event's
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
