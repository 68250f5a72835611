"""The balance of forces of a moving stem, block by block, with friction that varies: k, F_0, F_c and F_v v.

In a block of rows in which the stem is driven with sign s, U - k x - F_0 - s F_c - F_v v = s (w_s(x) + d(t)) + error.
The left side is linear in the parameters and the right side a Gaussian process, so that the marginal likelihood has a
closed form: the hyperparameters maximise its restricted form (REML), and the parameters follow by generalised least
squares. F_v here holds every lag between force and position: the sensor's, and the gauge's with the other sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor

from estimators.base import NORMAL_95, student_95
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.roughness import (
    ROUGH,
    SMOOTH,
    Roughness,
    RoughnessPrior,
    field_covariance,
    field_slopes,
    roughness_of,
    roughness_prior,
)
from estimators.engine.segmentation import Move
from estimators.engine.stops import ends_driven, last_row_before_stop
from estimators.linear_fit import inverse_of

FloatArray = npt.NDArray[np.float64]

MOST_BLOCKS: Final = 300
_SHORTEST_S: Final = 0.02
_FEWEST_STROKES: Final = 3
_BLOCK_SHARE: Final = 0.008  # of the travel: a third of the length of what is rough
_AFTER_BREAKAWAY_S: Final = 0.08  # the mass and the sensor filter show in what comes sooner
_ROWS_OF_START: Final = 1.5  # after the first that shows motion, where a jump lies between two
_SETTLED: Final = 6.0  # lags after a breakaway nothing is left of the jump
_BENT: Final = 3.0  # lags of the force's path after a corner it is straight again
_BEFORE_CORNER_S: Final = 0.03
_RATE_S: Final = 0.05  # to either side, over which it is asked whether the force goes on
_RATE_REACH_S: Final = 0.5  # the same for the rate of a force that bends
_STRAIGHT: Final = 0.02  # of its range: a force that leaves its line by less is a ramp
_WAITS: Final = 0.3  # of the rate of the rows that go on: less is a force that waits
_FEWEST_OF_DRIVE: Final = 4
_AVERAGED: Final = 80  # places of each direction, over the travel swept
_SEARCH: Final = {"maxiter": 30, "ftol": 1.0e-6}


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Means over blocks of rows in which the stem is driven in one direction, arrays of shape (n,)."""

    time_s: FloatArray
    travel_m: FloatArray
    rate_n_per_s: FloatArray
    force_n: FloatArray
    direction: FloatArray
    rows: FloatArray
    duration_s: FloatArray

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.time_s.size)


@dataclass(frozen=True, slots=True)
class Swept:
    """The travel that the stem swept, m, and the time recorded, s: what F_c and F_0 are told as averages over."""

    low_m: float
    high_m: float
    begin_s: float
    end_s: float


def swept(reading: Reading) -> Swept | None:
    """Return what the stem of a reading swept; None for a drive without a spring, whose strokes are alike."""
    if reading.spring_n_per_m <= 0.0:
        return None
    moves = [reading.position_m[one.first : one.last + 1] for one in reading.segmentation.moves]
    low_m, high_m = min(float(one.min()) for one in moves), max(float(one.max()) for one in moves)
    return Swept(low_m, high_m, float(reading.time_s[0]), float(reading.time_s[-1]))


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """What the balance gives; F_c and F_0 are the averages over the blocks.

    ``joint`` is the covariance of (k, F_0, F_c, F_v) so averaged. ``whole`` is the same as averages over the travel
    swept and the time recorded, None where that is not asked for.
    """

    symbols: tuple[str, ...]
    values: FloatArray
    joint: FloatArray
    roughness: Roughness
    smoothness: int
    prior: RoughnessPrior
    blocks: Blocks
    whole: Balance | None = None

    def known(self, symbol: str) -> Known:
        """Return value and standard error of this symbol."""
        at = self.symbols.index(symbol)
        return Known(float(self.values[at]), float(math.sqrt(max(self.joint[at, at], 0.0))))

    def over_travel(self, symbol: str) -> Known:
        """Return value and standard error of this symbol over all that was swept and recorded."""
        return (self.whole or self).known(symbol)


def ramps(reading: Reading, first: int, last: int, settled_s: float, driven_s: float) -> list[tuple[int, int]]:
    """First and last rows of the parts of these rows in which the force goes on, and does not wait at a value.

    A stem that is late goes on for a while behind a force that waits: it is in transients there, and again for
    ``settled_s`` after a wait, and not in balance. ``driven_s`` is when this motion began: a wait since then counts.
    """
    time_s, force_n = reading.time_s, reading.path.force_n
    since = min(int(np.searchsorted(time_s, driven_s)), first)
    rows = np.arange(since, last + 1)
    step = max(2, round(_RATE_S / reading.samples.period_s))
    before, after = np.maximum(rows - step, since), np.minimum(rows + step, last)
    rate = np.abs(force_n[after] - force_n[before]) / (time_s[after] - time_s[before])
    goes_on = rate > _WAITS * np.median(rate[rate > _WAITS * rate.max()])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], goes_on, [False]]).astype(np.int8)))
    parts = []
    for begin, end in zip((since + edges[::2]).tolist(), (since + edges[1::2] - 1).tolist(), strict=True):
        settled = since if begin == since else int(np.searchsorted(time_s, time_s[begin] + settled_s))
        begins = max(first, settled)
        ends = end if end == last else end - step  # the rate of the rows beside a wait is of both
        if ends - begins >= 2:
            parts.append((begins, ends))
    return parts


def settled_from_s(reading: Reading, move: Move, settled_s: float) -> float:
    """When nothing is left of a move's breakaway, s: so long after it, and behind the rows between which it jumped."""
    shown_s = float(reading.time_s[move.first])
    began_s = move.began_s if move.rest >= 0 else shown_s
    return max(began_s + settled_s, shown_s + _ROWS_OF_START * reading.samples.period_s)


def driven_blocks(reading: Reading, lag: Known) -> Blocks:
    """Cut the driven parts of the moves into blocks of ``_BLOCK_SHARE`` of the travel, from the slowest moves on.

    About MOST_BLOCKS in all: fast ramps that follow slow ones show the same roughness, and the dynamic level has them.
    ``lag`` is how late the stem follows the force, s.
    """
    time_s, position_m, force_n = reading.time_s, reading.position_m, reading.path.force_n
    corners_s, has_spring = reading.path.corners_s, reading.spring_n_per_m > 0.0
    longest_m = _BLOCK_SHARE * reading.travel_m
    period_s = float(np.median(np.diff(time_s)))
    settled_s = max(_SETTLED * lag.value, _AFTER_BREAKAWAY_S, _BENT * reading.path.lag_s)
    spans: list[tuple[int, int, int]] = []
    for move in reading.segmentation.moves:
        began_s = move.began_s if move.rest >= 0 else float(time_s[move.first])
        begin_s = settled_from_s(reading, move, settled_s)
        inside = corners_s[(corners_s > begin_s) & (corners_s < time_s[move.last])]
        end = last_row_before_stop(reading, move) if ends_driven(reading, move) else move.last
        edges = [begin_s, *inside.tolist(), float(time_s[end])]
        for left_s, right_s in pairwise(edges):
            first = int(np.searchsorted(time_s, left_s + (0.0 if left_s == begin_s else settled_s)))
            last = int(np.searchsorted(time_s, right_s - _BEFORE_CORNER_S)) - 1
            if last - first < 2:
                continue
            if not has_spring:
                spans.append((first, last, move.direction))
            elif move.direction * (force_n[last] - force_n[first]) > 0.0:
                driven_s = began_s if left_s == begin_s else left_s
                spans += [(*part, move.direction) for part in ramps(reading, first, last, settled_s, driven_s)]
    if has_spring:
        spans = _chosen(spans, time_s, position_m, longest_m)
    columns: list[tuple[float, ...]] = []
    for first, last, direction in spans:
        way_m = abs(float(position_m[last] - position_m[first]))
        longest = max(_SHORTEST_S, float(time_s[last] - time_s[first]) * longest_m / max(way_m, longest_m))
        length = max(1, round(longest / period_s))
        rate_n_per_s = _rate(time_s[first : last + 1], force_n[first : last + 1])
        count = max(1, (last - first + 1) // length)
        columns += [
            (
                float(time_s[rows].mean()),
                float(position_m[rows].mean()),
                float(rate_n_per_s[rows - first].mean()),
                float(force_n[rows].mean()),
                float(direction),
                float(rows.size),
                float(time_s[rows[-1]] - time_s[rows[0]]) + period_s,
            )
            for rows in np.array_split(np.arange(first, last + 1), count)
        ]
    if len(columns) > MOST_BLOCKS and not has_spring:
        # a drive may go to and fro many times, faster one way than the other: some blocks of every stroke
        columns = [columns[int(at)] for at in np.linspace(0.0, len(columns) - 1.0, MOST_BLOCKS)]
    table = np.array(columns).reshape(-1, 7).T
    return Blocks(*np.ascontiguousarray(table))


def _rate(time_s: FloatArray, force_n: FloatArray) -> FloatArray:
    """The rate of a force that goes on, N/s, at each of its rows: one rate where it is a ramp.

    A late stem does not follow what an I/P hunts about its ramp. A rate that has the hunting would say that the stem
    has no lag (regression dilution), and F_v v would count as F_c.
    """
    slope, at_zero = np.polyfit(time_s - time_s[0], force_n, 1)
    off_n = force_n - at_zero - slope * (time_s - time_s[0])
    if float(np.sqrt(np.mean(off_n**2))) < _STRAIGHT * float(np.ptp(force_n)):
        return np.full(time_s.size, slope)
    before = np.searchsorted(time_s, time_s - _RATE_REACH_S)
    after = np.minimum(np.searchsorted(time_s, time_s + _RATE_REACH_S), time_s.size - 1)
    return np.asarray((force_n[after] - force_n[before]) / (time_s[after] - time_s[before]))


def _chosen(
    spans: list[tuple[int, int, int]], time_s: FloatArray, position_m: FloatArray, longest_m: float
) -> list[tuple[int, int, int]]:
    """The slowest spans, as many of both directions as MOST_BLOCKS allows, in the order of time."""
    ways_m = [abs(float(position_m[last] - position_m[first])) for first, last, _ in spans]
    speeds = [
        way_m / float(time_s[last] - time_s[first]) for way_m, (first, last, _) in zip(ways_m, spans, strict=True)
    ]
    chosen: list[int] = []
    blocks = 0.0
    for number in np.argsort(np.round(np.log(np.maximum(speeds, 1.0e-12)), 1), kind="stable").tolist():
        if blocks >= MOST_BLOCKS and {spans[one][2] for one in chosen} == {1, -1}:
            break
        chosen.append(number)
        blocks += max(1.0, ways_m[number] / longest_m)
    return [spans[number] for number in sorted(chosen)]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The balance with its columns scaled, and what is known of the parameters beforehand (flat where 0)."""

    blocks: Blocks
    design: FloatArray
    scale: FloatArray
    variance: FloatArray
    prior_mean: FloatArray
    prior_information: FloatArray


def problem_of(
    blocks: Blocks, columns: Sequence[FloatArray], variance: FloatArray, beforehand: Mapping[int, Known]
) -> Problem:
    """Return the problem with these columns, shape (n,) each, in SI, and the error's variance of each block, N^2.

    ``beforehand`` has what is known of a column's factor.
    """
    design = np.column_stack(columns)
    # scaled, so that the information is well conditioned
    scale = np.sqrt(np.mean(design**2, axis=0))
    mean, information = np.zeros(scale.size), np.zeros(scale.size)
    for at, known in beforehand.items():
        mean[at], information[at] = known.value * scale[at], 1.0 / (known.std_error * scale[at]) ** 2
    return Problem(blocks, design / scale, scale, variance, mean, information)


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """What the forces of the blocks vary by with one set of hyperparameters: the field, and the error beside it."""

    field: FloatArray
    roughness: Roughness
    smoothness: int
    inverse: FloatArray
    log_determinant: float


def covariance_of(problem: Problem, logarithms: FloatArray, smoothness: int) -> Covariance:
    """Return the covariance with these hyperparameters, logarithms in the order of HYPERPARAMETERS, shape (6,)."""
    blocks, roughness = problem.blocks, roughness_of(logarithms)
    field = field_covariance(blocks.travel_m, blocks.time_s, blocks.direction, roughness, smoothness)
    whole = field + np.diag(problem.variance + roughness.error_n**2)
    factor = cho_factor(whole, lower=True, check_finite=False)[0]
    log_determinant = 2.0 * float(np.log(np.diag(factor)).sum())
    return Covariance(field, roughness, smoothness, inverse_of(factor), log_determinant)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Generalised least squares for one set of hyperparameters.

    ``objective`` is minus the logarithm of the marginal likelihood, but for what all problems with the same flat
    columns share.
    """

    objective: float
    theta: FloatArray
    theta_covariance: FloatArray
    covariance: Covariance
    left: FloatArray


def fit(problem: Problem, covariance: Covariance) -> Fit:
    """Return the fit of the problem with this covariance of its blocks."""
    design, force_n = problem.design, problem.blocks.force_n
    inverse_design = covariance.inverse @ design
    information = design.T @ inverse_design + np.diag(problem.prior_information)
    theta_covariance = np.linalg.inv(information)
    prior = problem.prior_information * problem.prior_mean
    theta = theta_covariance @ (inverse_design.T @ force_n + prior)
    off = theta - problem.prior_mean
    left = force_n - design @ theta
    known = problem.prior_information[problem.prior_information > 0.0]
    log_determinant = covariance.log_determinant + float(np.linalg.slogdet(information)[1] - np.log(known).sum())
    squares = float(left @ covariance.inverse @ left) + float(problem.prior_information @ off**2)
    return Fit(0.5 * (log_determinant + squares), theta, np.asarray(theta_covariance), covariance, left)


def _slope(problem: Problem, found: Fit) -> FloatArray:
    """The slope of the objective by the logarithms of the hyperparameters."""
    covariance = found.covariance
    weighted, inverse_design = covariance.inverse @ found.left, covariance.inverse @ problem.design
    projection = covariance.inverse - inverse_design @ found.theta_covariance @ inverse_design.T
    weight = projection - np.outer(weighted, weighted)
    blocks, roughness = problem.blocks, covariance.roughness
    places = blocks.travel_m, blocks.time_s, blocks.direction
    slopes = 0.5 * field_slopes(*places, roughness, covariance.smoothness, weight=weight)
    return np.append(slopes, roughness.error_n**2 * float(np.trace(weight)))


def balance(
    blocks: Blocks,
    *,
    noise_m: float,
    travel_m: float,
    has_spring: bool,
    force_noise_n: float,
    lag: Known,
    fewest_blocks: int = 8,
    over: Swept | None = None,
) -> Balance | None:
    """Return the balance of these blocks, None where they do not determine it.

    ``noise_m`` is the position's white noise of a row, ``travel_m`` the rated travel, ``force_noise_n`` the
    force's error of a block. ``lag`` is what is known beforehand of how late the stem follows the force, s.
    ``over`` is the travel swept and the time recorded, for what F_c and F_0 are there.
    """
    symbols = ("k", "F_0", "F_c", "F_v") if has_spring else ("F_0", "F_c")
    if blocks.count < (fewest_blocks if has_spring else _FEWEST_OF_DRIVE) or np.unique(blocks.direction).size < 2:
        return None
    columns = [np.ones(blocks.count), blocks.direction]
    if has_spring:
        columns = [blocks.travel_m, *columns, blocks.rate_n_per_s]
    late_n = lag.value * blocks.rate_n_per_s if has_spring else np.zeros(blocks.count)
    others = np.column_stack(columns[:3])
    scale = np.sqrt(np.mean(others**2, axis=0))
    roughly = np.linalg.lstsq(others / scale, blocks.force_n - late_n, rcond=None)[0] / scale
    friction_n = max(abs(float(roughly[symbols.index("F_c")])), 1.0e-6 * float(np.ptp(blocks.force_n)))
    prior = roughness_prior(friction_n, travel_m)
    spring = abs(float(roughly[0])) if has_spring else 0.0
    variance = (spring * noise_m) ** 2 / blocks.rows + force_noise_n**2
    problem = problem_of(blocks, columns, variance, {symbols.index("F_v"): lag} if has_spring else {})
    found = likeliest(problem, prior)
    at_blocks = _averaged(problem, symbols, found, prior, None)
    return at_blocks if over is None else replace(at_blocks, whole=_averaged(problem, symbols, found, prior, over))


@dataclass(frozen=True, slots=True, eq=False)
class Likeliest:
    """The fit with the likeliest hyperparameters, and these."""

    fit: Fit
    roughness: Roughness
    smoothness: int


def likeliest(problem: Problem, prior: RoughnessPrior) -> Likeliest:
    """Return the fit with the likeliest hyperparameters."""
    best: tuple[float, FloatArray, int] | None = None
    for smoothness in (ROUGH, SMOOTH):

        def surprise(at: FloatArray, smoothness: int = smoothness) -> tuple[float, FloatArray]:
            one = fit(problem, covariance_of(problem, at, smoothness))
            return one.objective, _slope(problem, one)

        least, at = prior.lowest(surprise, prior.middle, _SEARCH)
        if best is None or least < best[0]:
            best = least, at, smoothness
    assert best is not None
    _, at, smoothness = best
    found = fit(problem, covariance_of(problem, at, smoothness))
    return Likeliest(found, roughness_of(at), smoothness)


def _averaged(
    problem: Problem, symbols: tuple[str, ...], found: Likeliest, prior: RoughnessPrior, over: Swept | None
) -> Balance:
    """Move the field's average over the blocks, or over the travel swept, into F_c and F_0.

    Blocks may show a part of it, as where a stem slips far at each end: what friction is elsewhere is as unsure as it
    varies.
    """
    blocks, design, scale, fit = problem.blocks, problem.design, problem.scale, found.fit
    if over is None:
        direction, weight = blocks.direction, blocks.duration_s
        everywhere = fit.covariance.field
        across, among = everywhere, everywhere
    else:
        direction, weight = np.repeat([1.0, -1.0], _AVERAGED), np.ones(2 * _AVERAGED)
        places_m = np.tile(np.linspace(over.low_m, over.high_m, _AVERAGED), 2)
        times_s = np.tile(np.linspace(over.begin_s, over.end_s, _AVERAGED), 2)
        everywhere = field_covariance(
            np.concatenate([blocks.travel_m, places_m]),
            np.concatenate([blocks.time_s, times_s]),
            np.concatenate([blocks.direction, direction]),
            found.roughness,
            found.smoothness,
        )
        across, among = everywhere[blocks.count :, : blocks.count], everywhere[blocks.count :, blocks.count :]
    up, down = direction > 0.0, direction < 0.0
    # s f averaged over each direction; F_c takes half the difference, F_0 half the sum
    weight_up = np.where(up, weight, 0.0) / weight[up].sum()
    weight_down = np.where(down, weight, 0.0) / weight[down].sum()
    average = np.zeros((len(symbols), direction.size))
    average[symbols.index("F_c")] = 0.5 * (weight_up - weight_down)
    average[symbols.index("F_0")] = 0.5 * (weight_up + weight_down)
    gain = across @ fit.covariance.inverse
    values = fit.theta / scale + average @ (gain @ fit.left)
    moved = np.diag(1.0 / scale) - average @ gain @ design
    joint = average @ (among - gain @ across.T) @ average.T + moved @ fit.theta_covariance @ moved.T
    return Balance(symbols, values, joint, found.roughness, found.smoothness, prior, blocks)


def repeats_to_n(found: Balance) -> float:
    """Standard error of F_c and F_0 of a drive by how its strokes repeat, N: their scatter over their number.

    A drift is in it. 0 with too few strokes.
    """
    blocks = found.blocks
    stroke = np.concatenate([[0], np.cumsum(np.diff(blocks.direction) != 0.0)])
    means_n = np.bincount(stroke, blocks.force_n) / np.bincount(stroke)
    direction = np.sign(np.bincount(stroke, blocks.direction))
    variance = 0.0
    for way in (1.0, -1.0):
        own = means_n[direction == way]
        if own.size < _FEWEST_STROKES:
            return 0.0
        # half of the sum, or of the difference, of both directions' means
        variance += 0.25 * float(np.var(own, ddof=1)) / own.size * (student_95(own.size - 1) / NORMAL_95) ** 2
    return math.sqrt(variance)
