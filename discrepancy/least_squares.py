"""Bounded least squares by damped Gauss-Newton steps, first on blurred residuals, whose cost has fewer basins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from discrepancy.model import Model
from estimators.likelihood.intervals import inflation
from estimators.samples import BoolArray, FloatArray, IntArray

_DAMPINGS: Final = 10  # tried for one step
_CONVERGED: Final = 1.0e-4  # of the cost, that a step must win to be worth another
_BLURRED_CONVERGED: Final = 0.005
_LITTLE: Final = 0.05  # of the noise's own cost: no less than this is worth a step
_LARGEST_MOVE: Final = 2.0  # of a coordinate in one step


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where a fit ended: point (p,), residuals (count,) in standard deviations, their slopes (p, count), cost.

    The cost is the sum of squares of residuals and prior departures; infinite where nothing could be followed.
    ``refined_to``: the cost from which a search for other places led hardly lower; infinite where none was made.
    ``least_errors``: standard errors (p,) that walks along the cost leave (discrepancy.profile); None before them.
    """

    model: Model
    point: FloatArray
    residual: FloatArray
    slopes: FloatArray | None
    cost: float
    refined_to: float = math.inf
    least_errors: FloatArray | None = None

    @property
    def values(self) -> dict[str, float]:
        """Values by name."""
        return self.model.values(self.point)

    @property
    def is_followed(self) -> bool:
        """Whether there is a motion at all."""
        return math.isfinite(self.cost)


@dataclass(frozen=True, slots=True, eq=False)
class Blur:
    """Weighted means over spans of time: ``first`` is the first block of each span, shape (g,)."""

    first: IntArray | None

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Return residuals (..., count) as those of the spans, (..., g), each again of unit variance."""
        if self.first is None:
            return rows
        count = np.diff(np.append(self.first, rows.shape[-1]))
        return np.asarray(np.add.reduceat(rows, self.first, axis=-1) / np.sqrt(count))


def blur(model: Model, span_s: float) -> Blur:
    """Return the blur over spans of this length; 0 for none."""
    if span_s <= 0.0:
        return Blur(None)
    time_s = model.observed.time_s
    spans = np.floor((time_s - time_s[0]) / span_s)
    return Blur(np.flatnonzero(np.diff(spans, prepend=-np.inf) != 0.0))


def start_fit(model: Model, point: FloatArray) -> Fit:
    """Return the fit as it stands at a point."""
    residual = model.residuals(point)
    if residual is None:
        return Fit(model, point, np.full(model.observed.count, math.nan), None, math.inf)
    prior = model.unknowns.prior_residuals(point)
    return Fit(model, point, residual, None, float(residual @ residual + prior @ prior))


def on(model: Model, fit: Fit) -> Fit:
    """Return the fit as it stands with this model, of the same unknowns."""
    return fit if model is fit.model else start_fit(model, fit.point)


def descend(start: Fit, *, most_steps: int, span_s: float = 0.0, held: frozenset[str] = frozenset()) -> Fit:
    """Return the lowest point reached by at most so many steps on residuals that are blurred over ``span_s``.

    ``held`` unknowns stay, and all of them where the work of a diagnosis is done. Residuals that are larger than the
    noise, or hang together, count for so much less beside the priors: else a misfit of a thousand times the noise would
    buy any mass.
    """
    model, here = start.model, start
    if not here.is_followed:
        return here
    over = blur(model, span_s)
    unknowns, lower, upper = model.unknowns, model.unknowns.lower, model.unknowns.upper
    tempered = inflation(start.residual, model.observed.weight)
    prior_slopes = tempered * unknowns.prior_slopes()
    free = np.array([name not in held for name in unknowns.names])

    def priors(point: FloatArray) -> FloatArray:
        return tempered * unknowns.prior_residuals(point)

    soft = over(here.residual)
    cost = _cost(soft, priors(here.point))
    damping = 1.0e-3
    slopes = None
    for _ in range(most_steps):
        if model.tally.is_spent:
            break
        slopes = model.slopes(here.point, here.residual, free)
        columns = over(slopes)
        normal = columns @ columns.T + np.diag(prior_slopes**2)
        gradient = columns @ soft + prior_slopes * priors(here.point)
        scale = np.maximum(np.diag(normal), 1.0e-12 * max(float(np.diag(normal).max()), 1.0e-300))
        moved = None
        for _ in range(_DAMPINGS):
            trial = _stepped(here.point, (normal, gradient), damping * scale, (lower, upper), free)
            residual = model.residuals(trial)
            if residual is not None:
                blurred = over(residual)
                new_cost = _cost(blurred, priors(trial))
                if new_cost < cost:
                    moved = (trial, residual, blurred, new_cost)
                    break
            damping *= 5.0
        if moved is None:
            break
        won = cost - moved[3]
        here = Fit(model, moved[0], moved[1], None, 0.0)
        soft, cost, slopes = moved[2], moved[3], None
        damping = max(damping * 0.1, 1.0e-9)
        if span_s > 0.0 and won < _BLURRED_CONVERGED * cost:
            break
        if won < _CONVERGED * cost and won < max(_LITTLE * soft.size, 0.5) and won < 0.5 + 1.0e-6 * cost:
            break
    prior = unknowns.prior_residuals(here.point)
    complete = slopes if bool(free.all()) else None
    return Fit(model, here.point, here.residual, complete, _cost(here.residual, prior), start.refined_to)


def _cost(residual: FloatArray, prior: FloatArray) -> float:
    return float(residual @ residual + prior @ prior)


def _stepped(
    point: FloatArray,
    equations: tuple[FloatArray, FloatArray],
    damping: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    may_move: BoolArray,
) -> FloatArray:
    """Return the point after one damped step; what would leave its bounds is held there and the rest solved again."""
    normal, gradient = equations
    (lower, upper), free = bounds, may_move.copy()
    move = np.zeros(point.size)
    for _ in range(3):
        rows = np.flatnonzero(free)
        if rows.size == 0:
            break
        right = gradient[rows] + normal[np.ix_(rows, ~free)] @ move[~free]
        matrix = normal[np.ix_(rows, rows)] + np.diag(damping[rows])
        move[rows] = -np.linalg.lstsq(matrix, right, rcond=1.0e-13)[0]
        beyond = free & ((point + move < lower) | (point + move > upper))
        if not beyond.any():
            break
        move[beyond] = np.clip(point + move, lower, upper)[beyond] - point[beyond]
        free &= ~beyond
    return np.asarray(np.clip(point + np.clip(move, -_LARGEST_MOVE, _LARGEST_MOVE), lower, upper))
