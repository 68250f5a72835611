"""The I/P behind a polled command, from the measured pressure alone: gain, offset, lag and dead time.

    P(t) = offset + gain L(t - dead time) + swing exp(-(t - first step)/lag),  lag L' = u - L

u is the staircase of the commands. Lag and delay = lag + dead time are found on a grid that is drawn closer until it
holds their likelihood; means and covariance are taken over it, as without a lag the dead time's likelihood is flat
between two writes. The other three are linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import optimize

from estimators.likelihood.inputs.stair_kernel import stair_answer
from estimators.samples import BoolArray, FloatArray, position_noise, resolution

_FEWEST_ROWS: Final = 40
_SINGULAR: Final = 1.0e-12
_LONGEST_LAG_S: Final = 3.0
_LONGEST_DELAY_S: Final = 5.0
# Own choices, tried on triangles polled at 10 to 50 ms behind lags of 0 to 1 s.
_LAGS: Final = 9
_DELAYS: Final = 25
_GRID: Final = 11
_COARSE_ROWS: Final = 1000  # as many tell a lag and a delay to a tenth of a period
_CLOSER: Final = 14  # times that the grid is drawn anew
_HELD: Final = 18.0  # of chi square: the grid holds the likelihood where its edge is worse by more
_FILLED: Final = 0.3  # of the grid's length in both directions: then it is close enough
_SEEN_PERIODS: Final = 0.5
_OUTLIER: Final = 6.0
_MOST_OUTLIERS: Final = 0.02
_MORE_THAN_NOISE: Final = 1.35
_EXACT: Final = 1.0e-9  # of the span: what is left is rounding
_BLOCKS: Final = (4, 16, 64)
_WHITE: Final = 1.6  # times what the means of white noise scatter by, and 1 + 3/sqrt(blocks) for few


@dataclass(frozen=True, slots=True, eq=False)
class TransducerFit:
    """Offset, gain and swing (N, 1, N) in ``linear``, shape (3,); lag and dead time, s.

    ``root``, shape (4, 4): changes of offset, gain, swing and lag by one sigma along independent directions at a given
    delay; ``delay_sd_s``, the error of lag + dead time. ``noise_n``: what is left of the pressure, rms.
    """

    linear: FloatArray
    lag_s: float
    dead_time_s: float
    root: FloatArray
    delay_sd_s: float
    noise_n: float


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The staircase, the rows of pressure, the time within which the write was carried out, and the period."""

    step_s: FloatArray
    level_n: FloatArray
    time_s: FloatArray
    force_n: FloatArray
    lead_s: float
    period_s: float

    def columns(self, lag_s: float, delay_s: float) -> FloatArray:
        """Offset's, gain's and swing's columns as rows, shape (3, n), the gain's about the staircase's mean."""
        at_s = self.time_s - (delay_s - lag_s)
        answer = stair_answer(self.step_s, self.level_n, at_s, lag_s)
        # a swing that is over within a row or two cannot be told from an odd row
        is_seen = lag_s > _SEEN_PERIODS * self.period_s
        left = np.exp(-np.maximum(at_s - self.step_s[0], 0.0) / lag_s) if is_seen else np.zeros(at_s.size)
        return np.stack([np.ones(at_s.size), answer - float(self.level_n.mean()), left])

    def solved(self, lag_s: float, delay_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Linear parameters, shape (3,), their inverse normal matrix and the residual, shape (n,)."""
        columns = self.columns(lag_s, delay_s)
        size = np.sqrt(np.einsum("ij,ij->i", columns, columns))
        size[size == 0.0] = 1.0
        columns /= size[:, None]
        information, directions = np.linalg.eigh(columns @ columns.T)
        told = information > _SINGULAR * information[-1]
        inverse = (directions[:, told] / information[told]) @ directions[:, told].T
        share = inverse @ (columns @ self.force_n)
        return share / size, inverse / np.outer(size, size), self.force_n - share @ columns

    def cost(self, lag_s: float, delay_s: float) -> float:
        """Sum of squares left, N^2; infinite where lag or dead time cannot be."""
        if lag_s < 0.0 or delay_s - lag_s < -self.period_s:
            return float("inf")
        residual = self.solved(lag_s, delay_s)[2]
        return float(residual @ residual)

    def prior(self, lag_s: float, delay_s: float) -> float:
        """Square of how much earlier than its write a step would act, in standard deviations of the write's instant."""
        return float((min(delay_s - lag_s, 0.0) * np.sqrt(12.0) / self.lead_s) ** 2)


def fit_transducer(
    step_s: FloatArray, level_n: FloatArray, time_s: FloatArray, force_n: FloatArray, wire: tuple[float, float]
) -> TransducerFit | None:
    """Fit the I/P to the measured pressure times area, shape (n,), NaN where it is missing; None where none fits.

    ``step_s`` and ``level_n``, shape (k,), are the commands; ``wire`` holds within which time a write was
    carried out, and the period, s.
    """
    present = np.isfinite(force_n)
    if int(present.sum()) < _FEWEST_ROWS:
        return None
    time_s, force_n = time_s[present], force_n[present]
    rows = _Rows(step_s, level_n, time_s, force_n, *wire)
    lag_s, delay_s = _nearest(rows, *_coarse(rows))
    kept = _inliers(rows.solved(lag_s, delay_s)[2], resolution(np.sort(force_n)))
    rows = _Rows(step_s, level_n, time_s[kept], force_n[kept], *wire)
    lag_s, delay_s = _nearest(rows, lag_s, delay_s)
    # where the best leaves more than noise the likelihood, which takes most of the work, tells nothing
    if rows.time_s.size < (1.0 - _MOST_OUTLIERS) * time_s.size or not _is_noise(rows, lag_s, delay_s):
        return None
    found = _likelihood(rows, lag_s, delay_s)
    lag_s, delay_s = found.mean
    if not _is_noise(rows, lag_s, delay_s):
        return None
    residual = rows.solved(lag_s, delay_s)[2]
    return _concluded(rows, found, float(np.sqrt(residual @ residual / max(residual.size - 5, 1))))


def _coarse(rows: _Rows) -> tuple[float, float]:
    """Lag and delay of the least cost of some of the rows, to a tenth of a period."""
    every = max(1, rows.time_s.size // _COARSE_ROWS)
    rows = replace(rows, time_s=rows.time_s[::every].copy(), force_n=rows.force_n[::every].copy())
    lags = np.concatenate([[0.0], np.geomspace(0.25 * rows.period_s, _LONGEST_LAG_S, _LAGS)])
    best = (float("inf"), 0.0, 0.0)
    for lag_s in lags:
        low_s, high_s = float(lag_s) - rows.period_s, float(lag_s) + _LONGEST_DELAY_S
        while high_s - low_s > 0.1 * rows.period_s:
            delays = np.linspace(low_s, high_s, _DELAYS)
            costs = [rows.cost(float(lag_s), float(delay_s)) for delay_s in delays]
            at = int(np.argmin(costs))
            best = min(best, (costs[at], float(lag_s), float(delays[at])))
            low_s, high_s = float(delays[max(at - 1, 0)]), float(delays[min(at + 1, _DELAYS - 1)])
    return best[1], best[2]


def _nearest(rows: _Rows, lag_s: float, delay_s: float) -> tuple[float, float]:
    """Lag and delay of the least cost, by a simplex: without a lag the cost has no slope."""
    reach_s, count = 0.3 * max(lag_s, rows.period_s), rows.time_s.size
    corners = [(lag_s, delay_s), (lag_s + reach_s, delay_s), (lag_s, delay_s + 0.3 * rows.period_s)]

    def objective(at: FloatArray) -> float:
        lag_s, delay_s = float(at[0]), float(at[1])
        return rows.cost(lag_s, delay_s) * (1.0 + rows.prior(lag_s, delay_s) / count)

    start = np.array(corners)
    found = optimize.fmin(objective, start[0], xtol=1.0e-7, ftol=np.inf, maxfun=300, disp=False, initial_simplex=start)
    return float(found[0]), float(found[1])


def _inliers(residual: FloatArray, step_n: float) -> BoolArray:
    """Rows that are no outliers; a pressure on a grid may be most often exact, and off by a step ``step_n`` else."""
    middle = float(np.median(residual))
    scatter = 1.4826 * float(np.median(np.abs(residual - middle)))
    return np.asarray(np.abs(residual - middle) <= _OUTLIER * max(scatter, step_n / np.sqrt(12.0), 1.0e-300))


@dataclass(frozen=True, slots=True, eq=False)
class _Likelihood:
    """Grid of lags and delays with their weights, shape (g,), and their means."""

    lag_s: FloatArray
    delay_s: FloatArray
    weight: FloatArray

    @property
    def mean(self) -> tuple[float, float]:
        return float(self.weight @ self.lag_s), float(self.weight @ self.delay_s)


def _likelihood(rows: _Rows, lag_s: float, delay_s: float) -> _Likelihood:
    """Weigh lags about the best, each with the delays that go with it: a short lag and a dead time hide each other."""
    count = rows.time_s.size
    rounding = count * (_EXACT * float(np.ptp(rows.force_n))) ** 2
    least = max(rows.cost(lag_s, delay_s), rounding, 1.0e-300)
    near_s = {lag_s: (delay_s, 0.1 * rows.period_s)}
    delays: dict[float, tuple[FloatArray, FloatArray]] = {}

    def chi_of(lag: float) -> float:
        start_s, half_s = near_s[min(near_s, key=lambda other: abs(other - lag))]

        def chi(delay: float) -> float:
            return (rows.cost(lag, delay) - least) / least * count + rows.prior(lag, delay)

        delays[lag] = found_s, square = _held(chi, start_s - half_s, start_s + half_s, -np.inf)
        weight = np.exp(-0.5 * (square - square.min()))
        near_s[lag] = float(weight @ found_s / weight.sum()), 0.6 * float(np.ptp(found_s))
        best = float(square.min())
        sum_s = float(np.exp(-0.5 * (square - best)).sum()) * float(found_s[1] - found_s[0])
        return best - 2.0 * float(np.log(max(sum_s, 1.0e-300)))

    reach_s = 0.02 * lag_s + 0.01 * rows.period_s
    lags, square = _held(chi_of, max(lag_s - reach_s, 0.0), lag_s + reach_s, 0.0)
    parts = []
    for lag, own in zip(lags, np.exp(-0.5 * (square - square.min())), strict=True):
        found_s, chi = delays[float(lag)]
        share = np.exp(-0.5 * (chi - chi.min()))
        parts.append((np.full(found_s.size, lag), found_s, own * share / share.sum()))
    grid_lag, grid_delay, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _Likelihood(grid_lag, grid_delay, weight / weight.sum())


def _held(chi: Callable[[float], float], low: float, high: float, floor: float) -> tuple[FloatArray, FloatArray]:
    """Places, shape (g,), on a line that grows and shrinks until it holds what is likely, and their chi squares."""
    at, square = np.linspace(low, high, _GRID), np.empty(_GRID)
    for _ in range(_CLOSER):
        square = np.array([chi(float(place)) for place in at])
        held = np.flatnonzero(square < square.min() + _HELD)
        first, last, step = int(held[0]), int(held[-1]), float(at[1] - at[0])
        at_floor = first == 0 and float(at[0]) <= floor
        if (first > 0 or at_floor) and last < _GRID - 1 and last - first > _FILLED * _GRID:
            break
        low = float(at[0]) + (first - 1) * step if first > 0 else float(at[0]) - _GRID * step
        high = float(at[last]) + (1 if last < _GRID - 1 else _GRID) * step
        at = np.linspace(max(low, floor), high, _GRID)
    return at, square


def _is_noise(rows: _Rows, lag_s: float, delay_s: float) -> bool:
    """Whether what is left there is white and no more than the pressure's own noise."""
    residual = rows.solved(lag_s, delay_s)[2]
    noise_n = position_noise(rows.time_s, rows.force_n, np.zeros(rows.time_s.size, dtype=np.int64))
    rms_n = float(np.sqrt(np.mean(residual**2)))
    if rms_n <= _EXACT * float(np.ptp(rows.force_n)):
        return True
    if noise_n == 0.0 or rms_n > _MORE_THAN_NOISE * noise_n:
        return False
    for length in _BLOCKS:
        count = residual.size // length
        if count < 8:
            break
        means = residual[: count * length].reshape(count, length).mean(axis=1)
        if float(np.sqrt(np.mean(means**2) * length)) > _WHITE * (1.0 + 1.0 / np.sqrt(count)) * rms_n:
            return False
    return True


def _concluded(rows: _Rows, found: _Likelihood, noise_n: float) -> TransducerFit:
    lag_s, delay_s = found.mean
    heavy = np.flatnonzero(found.weight > 1.0e-5 * found.weight.max())
    solved = np.array(
        [rows.solved(float(found.lag_s[i]), float(found.delay_s[i]))[0] for i in heavy],
    )
    weight = found.weight[heavy] / found.weight[heavy].sum()
    all_of = np.column_stack([solved, found.lag_s[heavy], found.delay_s[heavy]])
    away = all_of - weight @ all_of
    covariance = away.T @ (away * weight[:, None])
    linear, inverse, _ = rows.solved(lag_s, delay_s)
    covariance[:3, :3] += noise_n**2 * inverse
    # offset at a command of 0, where the columns have it at the mean command
    turn = np.eye(5)
    turn[0, 1] = -float(rows.level_n.mean())
    covariance = turn @ covariance @ turn.T
    delay_variance = float(covariance[4, 4])
    given = covariance[:4, :4] - np.outer(covariance[:4, 4], covariance[:4, 4]) / max(delay_variance, 1.0e-300)
    return TransducerFit(
        linear=(turn[:3, :3] @ linear),
        lag_s=lag_s,
        dead_time_s=delay_s - lag_s,
        root=_root(given),
        delay_sd_s=float(np.sqrt(delay_variance)),
        noise_n=noise_n,
    )


def _root(covariance: FloatArray) -> FloatArray:
    """Changes by one sigma along the eigen-directions of the correlations, shape (d, d)."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1.0e-300))
    variances, directions = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    return np.asarray((directions * np.sqrt(np.clip(variances, 0.0, None))).T * sigma)
