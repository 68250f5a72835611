r"""The balance of forces over many moves: friction, breakaway, spring and preload, with what varies along the way.

At each observation j, signal_j = c + k x_j + s_j f_j + noise. In motion f = F + w_s(x) + d(t), at a breakaway
f = F_s + q (w_s(x) + d(t)) with q = F_s / F. w is the packing's roughness along the travel, in part the same both
ways, d wanders in time, and c has a part that wanders (a flow's force on the plug). All are Gaussian processes, their
sizes are found by restricted maximum likelihood (Patterson & Thompson 1971), and the friction that is given is the mean
over the travel that was swept (universal kriging; Cressie 1993, section 3.4). Intervals mix the sizes that are nearly
as likely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from estimators.in_service.events import Kind, Observations
from estimators.in_service.moves import IntArray
from valve.recording import FloatArray

MIDDLE, SPRING, MOTION, UP, DOWN = range(5)  # columns: c, k, F, and F_s of each direction

_MOST_CELLS: Final = 220  # observations that go into the covariance; more are averaged over their neighbours
_PLACE_CELL: Final = 0.005  # of the travel: observations that near to each other are one place
_GRID_POINTS: Final = 24  # of travel and of time, for the means that are asked for
_ALIKE: Final = 0.5  # share of the roughness' variance that is the same both ways, of usual packings
# What the sizes of packings usually are, as shares of F, and by which factor they may be off (one standard deviation).
_USUAL_SIZES: Final = {"roughness": (0.015, 2.0), "wander": (0.006, 2.5), "zero": (0.003, 3.0)}
_LEAST_SHARE: Final = 5.0e-4
_STEPS: Final = (4.0, 2.0, 1.41)  # by which factor each size is tried up and down
_LENGTHS: Final = (0.01, 0.03, 0.1)  # of the travel, of the roughness
_TIMES_S: Final = (60.0, 600.0, 6000.0)
_OUTLIER: Final = 4.5  # standard deviations


@dataclass(frozen=True, slots=True)
class Sizes:
    """Standard deviations in the signal's unit, the roughness' length and the wander's time."""

    motion: float
    breakaway: float
    roughness: float
    wander: float
    zero: float
    length: float
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """``values`` and ``covariance`` of c, k, F, F_s up and F_s down, shapes (5,) and (5, 5), in the signal's unit.

    F and F_s are means over the travel that was swept. NaN stands where there was no observation. ``freedom``:
    Student's; ``scatter``: from breakaway to breakaway, one standard deviation; ``spring_error``: standard error of k
    from the moves alone, without what the nameplate says.
    """

    values: FloatArray
    covariance: FloatArray
    freedom: float
    scatter: float
    spring: float
    spring_error: float

    def combined(self, weights: FloatArray) -> tuple[float, float]:
        """Value and standard error, in the signal's unit, of a sum of these values with weights, shape (5,)."""
        return float(weights @ self.values), math.sqrt(max(float(weights @ self.covariance @ weights), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Observations, averaged over neighbours; arrays of shape (n,)."""

    time_s: FloatArray
    position: FloatArray
    signal: FloatArray
    read: FloatArray  # variance that the rows leave
    count: FloatArray
    sign: IntArray
    kind: IntArray


def balanced(
    seen: Observations,
    *,
    travel: float,
    swept: tuple[tuple[float, float], tuple[float, float]],
    spring: tuple[float, float] | None,
) -> Balance | None:
    """Return the balance of these observations; None where there are too few to have one.

    ``swept``: from where to where the stem moved up, and down. ``spring``: k of the nameplate and by how much it may be
    off (one standard deviation), None where it is not known.
    """
    if seen.count < 8 or np.unique(seen.sign[seen.kind == Kind.MOTION]).size < 2:
        return None
    found = _fitted(_cells(seen, travel), travel, swept, spring, _moves(seen))
    off = _standardised(seen, found)
    if (np.abs(off) > _OUTLIER).any():
        kept = seen.chosen(np.abs(off) <= _OUTLIER)
        if kept.count >= 8 and np.unique(kept.sign[kept.kind == Kind.MOTION]).size == 2:
            found = _fitted(_cells(kept, travel), travel, swept, spring, _moves(kept))
    return found


def _moves(seen: Observations) -> int:
    return int(np.unique(seen.move).size)


def _standardised(seen: Observations, found: Balance) -> FloatArray:
    """Residuals by their robust deviation, shape (n,)."""
    left = seen.signal - _columns(seen.position, seen.sign, seen.kind) @ np.nan_to_num(found.values)
    size = np.empty(seen.count)
    for kind in Kind:
        own = seen.kind == kind
        if own.any():
            size[own] = 1.4826 * np.median(np.abs(left[own] - np.median(left[own])))
    return np.asarray(left / np.maximum(np.hypot(size, seen.half_width), 1.0e-300))


def _columns(position: FloatArray, sign: IntArray, kind: IntArray) -> FloatArray:
    columns = np.zeros((position.size, 5))
    columns[:, MIDDLE], columns[:, SPRING] = 1.0, position
    columns[:, MOTION] = np.where(kind == Kind.MOTION, sign, 0)
    columns[:, UP] = np.where((kind == Kind.BREAKAWAY) & (sign > 0), 1.0, 0.0)
    columns[:, DOWN] = np.where((kind == Kind.BREAKAWAY) & (sign < 0), -1.0, 0.0)
    return columns


def _cells(seen: Observations, travel: float) -> _Cells:
    """Average neighbours: same kind, direction and place, and as near in time as keeps the number of cells bounded."""
    place = np.floor(seen.position / (_PLACE_CELL * travel)).astype(np.int64)
    span_s = float(np.ptp(seen.time_s)) + 1.0
    group = np.arange(seen.count)
    blocks = 512
    while np.unique(group).size > _MOST_CELLS:
        wide = max(1, 32 // blocks) if blocks else 64
        time = np.floor(seen.time_s / span_s * blocks).astype(np.int64) if blocks > 1 else np.zeros_like(place)
        keys = np.stack([seen.kind, seen.sign, place // wide, time], axis=1)
        group = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        if blocks <= 1:
            break
        blocks //= 2
    count = np.bincount(group).astype(np.float64)
    first = np.unique(group, return_index=True)[1]

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(group, weights=values) / count)

    # a value is anywhere within its half width: a third of the square
    return _Cells(
        mean(seen.time_s),
        mean(seen.position),
        mean(seen.signal),
        mean(seen.half_width**2) / 3.0 / count,
        count,
        seen.sign[first],
        seen.kind[first],
    )


class _Fit:
    """The restricted likelihood of sizes, and the values with their covariance at these."""

    def __init__(
        self,
        cells: _Cells,
        travel: float,
        swept: tuple[tuple[float, float], tuple[float, float]],
        spring: tuple[float, float] | None,
    ) -> None:
        columns = _columns(cells.position, cells.sign, cells.kind)
        self.used = np.flatnonzero(np.abs(columns).sum(axis=0) > 0.0)
        self._centre = float(cells.position.mean())
        columns[:, SPRING] -= self._centre
        self._columns, self._cells = columns[:, self.used], cells
        self._prior = np.zeros((self.used.size, self.used.size))
        self._prior_pull = np.zeros(self.used.size)
        at = int(np.flatnonzero(self.used == SPRING)[0])
        scale = float(np.ptp(cells.signal)) / max(float(np.ptp(cells.position)), 1.0e-12)
        rate, error = spring if spring is not None else (0.0, 100.0 * scale)
        self._prior[at, at], self._prior_pull[at] = 1.0 / error**2, rate / error**2
        plain = np.linalg.solve(
            self._columns.T @ self._columns
            + self._prior * float(np.var(cells.signal))
            + 1.0e-12 * np.eye(self.used.size),
            self._columns.T @ cells.signal + self._prior_pull * float(np.var(cells.signal)),
        )
        left = cells.signal - self._columns @ plain
        self.left = max(float(np.std(left)), 1.0e-9 * float(np.abs(cells.signal).max()))
        by_column = dict(zip(self.used.tolist(), plain.tolist(), strict=True))
        self.friction = max(abs(by_column[MOTION]), 2.0 * self.left)
        statics = [by_column[one] for one in (UP, DOWN) if one in by_column]
        self._share = float(np.clip(np.mean(statics) / self.friction, 1.0, 2.0)) if statics else 1.0
        self._travel, self._swept = travel, swept
        self._prepare()

    def _prepare(self) -> None:
        """Distances between observations, and from them to the grids of travel and time, once for all sizes."""
        cells = self._cells
        load = cells.sign * np.where(cells.kind == Kind.BREAKAWAY, self._share, 1.0)
        alike = np.where(cells.sign[:, None] == cells.sign[None, :], 1.0, _ALIKE)
        self._loads, self._alike = load[:, None] * load[None, :], alike
        self._apart = np.abs(cells.position[:, None] - cells.position[None, :])
        self._apart_s = np.abs(cells.time_s[:, None] - cells.time_s[None, :])
        self._load = load
        self._grid_s = np.linspace(float(cells.time_s.min()), float(cells.time_s.max()), _GRID_POINTS)
        places = [np.linspace(low, high, _GRID_POINTS) for low, high in self._swept]
        self._grid = np.concatenate(places)
        self._grid_sign = np.repeat([1, -1], _GRID_POINTS)

    def covariance(self, sizes: Sizes) -> FloatArray:
        """Covariance of the observations, shape (n, n)."""
        cells = self._cells
        own = np.where(cells.kind == Kind.BREAKAWAY, sizes.breakaway**2, sizes.motion**2) / cells.count + cells.read
        in_time = np.exp(-self._apart_s / sizes.time_s)
        total = self._loads * (
            sizes.roughness**2 * self._alike * np.exp(-self._apart / (sizes.length * self._travel))
            + sizes.wander**2 * in_time
        )
        total += sizes.zero**2 * in_time
        total[np.diag_indices_from(total)] += own + 1.0e-10 * self.left**2
        return np.asarray(total)

    def solved(self, sizes: Sizes) -> tuple[float, FloatArray, FloatArray]:
        """Restricted log likelihood with what packings usually are, the five values and their covariance."""
        columns, signal = self._columns, self._cells.signal
        try:
            factor = cho_factor(self.covariance(sizes), lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return -math.inf, np.full(5, np.nan), np.full((5, 5), np.nan)
        whole = cho_solve(factor, np.column_stack([columns, signal]), check_finite=False)
        inner = columns.T @ whole[:, :-1] + self._prior
        precise = np.linalg.inv(inner + 1.0e-14 * np.diag(np.diag(inner)))
        values = precise @ (columns.T @ whole[:, -1] + self._prior_pull)
        left = signal - columns @ values
        weighted = whole[:, -1] - whole[:, :-1] @ values
        level = -0.5 * (
            2.0 * float(np.log(np.diag(factor[0])).sum()) + float(np.linalg.slogdet(inner)[1]) + float(left @ weighted)
        ) + self._usual(sizes)
        # what the fields add on average over travel and time to the friction, given the observations
        between = self._to_means(sizes)
        weights = cho_solve(factor, between, check_finite=False)
        means = weights.T @ left
        spread = self._means_covariance(sizes) - between.T @ weights
        reach = -(columns.T @ weights)
        asked = self._asked()  # (used, 5) of the values, then what the means add
        full = asked.T @ values + self._added() @ means
        lead = asked + reach @ self._added().T
        covariance = lead.T @ precise @ lead + self._added() @ spread @ self._added().T
        return level, self._whole(full), self._whole_matrix(covariance)

    def _usual(self, sizes: Sizes) -> float:
        total = 0.0
        for name, (share, factor) in _USUAL_SIZES.items():
            off = math.log(max(getattr(sizes, name), _LEAST_SHARE * self.friction) / (share * self.friction))
            total -= 0.5 * (off / math.log(factor)) ** 2
        return total

    def _asked(self) -> FloatArray:
        """From the fitted columns to those that were observed, with the middle at position 0."""
        asked = np.eye(self.used.size)
        if SPRING in self.used and MIDDLE in self.used:
            spring, middle = (int(np.flatnonzero(self.used == one)[0]) for one in (SPRING, MIDDLE))
            asked[spring, middle] = -self._centre
        return asked

    def _added(self) -> FloatArray:
        """By how much the means of w up, w down and d enter each value, shape (used, 3)."""
        weights = {MOTION: (0.5, 0.5, 1.0), UP: (self._share, 0.0, self._share), DOWN: (0.0, self._share, self._share)}
        return np.array([weights.get(one, (0.0, 0.0, 0.0)) for one in self.used.tolist()])

    def _to_means(self, sizes: Sizes) -> FloatArray:
        """Covariance of the observations with the means of w up, w down and d, shape (n, 3)."""
        cells = self._cells
        apart = np.abs(cells.position[:, None] - self._grid[None, :])
        alike = np.where(cells.sign[:, None] == self._grid_sign[None, :], 1.0, _ALIKE)
        rough = sizes.roughness**2 * alike * np.exp(-apart / (sizes.length * self._travel))
        time = sizes.wander**2 * np.exp(-np.abs(cells.time_s[:, None] - self._grid_s[None, :]) / sizes.time_s)
        means = np.column_stack(
            [rough[:, :_GRID_POINTS].mean(axis=1), rough[:, _GRID_POINTS:].mean(axis=1), time.mean(axis=1)]
        )
        return np.asarray(self._load[:, None] * means)

    def _means_covariance(self, sizes: Sizes) -> FloatArray:
        apart = np.abs(self._grid[:, None] - self._grid[None, :])
        alike = np.where(self._grid_sign[:, None] == self._grid_sign[None, :], 1.0, _ALIKE)
        rough = sizes.roughness**2 * alike * np.exp(-apart / (sizes.length * self._travel))
        time = np.exp(-np.abs(self._grid_s[:, None] - self._grid_s[None, :]) / sizes.time_s)
        total = np.zeros((3, 3))
        halves = slice(0, _GRID_POINTS), slice(_GRID_POINTS, None)
        for one, rows in enumerate(halves):
            for other, columns in enumerate(halves):
                total[one, other] = rough[rows, columns].mean()
        total[2, 2] = sizes.wander**2 * time.mean()
        return total

    def _whole(self, values: FloatArray) -> FloatArray:
        whole = np.full(5, np.nan)
        whole[self.used] = values
        return whole

    def _whole_matrix(self, covariance: FloatArray) -> FloatArray:
        whole = np.full((5, 5), np.nan)
        whole[np.ix_(self.used, self.used)] = covariance
        return whole


def _fitted(
    cells: _Cells,
    travel: float,
    swept: tuple[tuple[float, float], tuple[float, float]],
    spring: tuple[float, float] | None,
    moves: int,
) -> Balance:
    fit = _Fit(cells, travel, swept, spring)
    tried: dict[Sizes, tuple[float, FloatArray, FloatArray]] = {}

    def level(sizes: Sizes) -> float:
        if sizes not in tried:
            tried[sizes] = fit.solved(sizes)
        return tried[sizes][0]

    share = fit.friction
    best = Sizes(0.7 * fit.left, 0.7 * fit.left, 0.015 * share, 0.006 * share, 0.003 * share, 0.03, 600.0)
    level(best)
    for factor in _STEPS:
        for _ in range(2):
            before = best
            for name in ("motion", "breakaway", "roughness", "wander", "zero"):
                for changed in (getattr(best, name) * factor, getattr(best, name) / factor):
                    other = replace(best, **{name: changed})
                    best = other if level(other) > level(best) + 1.0e-9 else best
            for length in _LENGTHS:
                other = replace(best, length=length)
                best = other if level(other) > level(best) else best
            for time_s in _TIMES_S:
                other = replace(best, time_s=time_s)
                best = other if level(other) > level(best) else best
            if best == before:
                break
    return _mixed(list(tried.items()), best, spring, moves)


def _mixed(
    tried: list[tuple[Sizes, tuple[float, FloatArray, FloatArray]]],
    best: Sizes,
    spring: tuple[float, float] | None,
    moves: int,
) -> Balance:
    """Mix the sizes that are nearly as likely as the best."""
    levels = np.array([found[0] for _, found in tried])
    weights = np.exp(levels - levels.max())
    near = weights > 1.0e-3
    weights = weights[near] / weights[near].sum()
    kept = [found for (_, found), is_near in zip(tried, near, strict=True) if is_near]
    values = np.sum([weight * one[1] for weight, one in zip(weights, kept, strict=True)], axis=0)
    covariance = np.sum(
        [
            weight * (one[2] + np.outer(one[1] - values, one[1] - values))
            for weight, one in zip(weights, kept, strict=True)
        ],
        axis=0,
    )
    rate, variance = float(values[SPRING]), float(covariance[SPRING, SPRING])
    if spring is not None:
        own = 1.0 / variance - 1.0 / spring[1] ** 2
        if own > 1.0e-6 / spring[1] ** 2:
            rate, variance = (rate / variance - spring[0] / spring[1] ** 2) / own, 1.0 / own
        else:
            variance = math.inf
    freedom = max(2.0, moves - 3.0)
    return Balance(values, covariance, freedom, best.breakaway, rate, math.sqrt(variance))
