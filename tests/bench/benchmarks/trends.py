"""Forecasts of worn valves: which method meets the night of the limit, and how often a healthy valve is alarmed.

A valve's figure is truth x (1 + wander) x (1 + error), one test a night. The wander is 3 % a night: new each night, or
forgotten over 3 or 10 nights. The error of a test has the spread that docs/accuracy.md measured of F_c, and one test in
100 is odd. The baseline is the first test. The number after the name is that of the valves without wear.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from service.health.forecast import BEYOND, LATEST, STEP, TOLD
from service.health.step import steps_of
from service.health.trend import LEAST_TESTS, MOST_TESTS, lines_through
from service.model.health_limits import HealthLimits
from valve.recording import FloatArray

VALVES: Final = 1000
NIGHTS: Final = 90
WANDER: Final = 0.03
WANDERS: Final = {"new each night": 0.0, "over 3 nights": 3.0, "over 10 nights": 10.0}
_ERRORS: Final = (0.003, 0.012)  # standard deviation of a test's own error: docs/accuracy.md, F_c of usual packings
_ODD: Final = (0.01, 0.10)  # share of odd tests, and how far off they are
_WORN: Final = 30  # valves a law, duration and wander
_DURATIONS: Final = (60, 150, 300)  # nights from new to the limit
_FIVE_YEARS: Final = 1826.0
_FROM_NIGHT: Final = 10
_SEEN: Final = 6  # of the nights without wear each method but the chosen one sees every sixth
_FIRST_NIGHTS: Final = 30  # before a step
_BOOTSTRAPPED: Final = 40  # tests
_RESAMPLES: Final = 60
_BLOCK: Final = 5  # nights
_LIMIT: Final = HealthLimits().friction_up_percent / 100.0
_DAYS: Final = HealthLimits().forecast_days

#: Wear as a share of the limit over the share of the time; 1 at 1. The last one stays below the limit.
LAWS: Final[Mapping[str, Callable[[FloatArray], FloatArray]]] = {
    "linear": lambda at: at,
    "linear, from 40 % of the time on": lambda at: np.maximum(0.0, (at - 0.4) / 0.6),
    "accelerating": lambda at: np.expm1(3.0 * at) / np.expm1(3.0),
    "saturating": lambda at: np.expm1(-at) / np.expm1(-1.0),
}

Flags = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True, slots=True)
class Forecast:
    """Of each valve, shape (n_valves,): nights until the limit with the interval, if a trend is sure, its level."""

    nights: FloatArray
    earliest: FloatArray
    latest: FloatArray
    sure: Flags
    level: FloatArray


Method = Callable[[FloatArray, FloatArray], Forecast]


def drawn(truth: FloatArray, valves: int, forgotten: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return figures, shape (n_nights, n_valves), of one truth, shape (n_nights,), and half widths of their tests."""
    shape = (truth.size, valves)
    new = rng.standard_normal(shape)
    keeps = np.exp(-1.0 / forgotten) if forgotten > 0.0 else 0.0
    for night in range(1, truth.size):
        new[night] = keeps * new[night - 1] + np.sqrt(1.0 - keeps**2) * new[night]
    error = np.exp(rng.uniform(np.log(_ERRORS[0]), np.log(_ERRORS[1]), valves))
    off = error * rng.standard_normal(shape)
    off += np.where(rng.random(shape) < _ODD[0], rng.choice((-1.0, 1.0), shape) * _ODD[1], 0.0)
    return truth[:, None] * (1.0 + WANDER * new) * (1.0 + off), 1.96 * error


def line_in_wander(most: int = MOST_TESTS) -> Method:
    """Return the line of service/health/trend.py, over that many tests."""

    def forecast(figures: FloatArray, limit: FloatArray) -> Forecast:
        near = figures[-most:]
        found = lines_through(np.arange(1.0 - len(near), 1.0), near)
        variances = tuple(found.quantile**2 * one for one in found.covariance)
        return _met(found.level, found.per_day, variances, limit)

    return forecast


def theil_sen(figures: FloatArray, limit: FloatArray) -> Forecast:
    """Median of the pairs' slopes with its interval by ranks (Theil 1950, Sen 1968), over 60 tests."""
    near = figures[-60:]
    count, days = len(near), np.arange(1.0 - len(near), 1.0)
    slopes = np.sort(_pairs(near, days), axis=0)
    reach = 1.96 * np.sqrt(count * (count - 1) * (2 * count + 5) / 18.0)
    low = slopes[max(round((len(slopes) - reach) / 2.0) - 1, 0)]
    high = slopes[min(round((len(slopes) + reach) / 2.0), len(slopes) - 1)]
    middle = np.median(slopes, axis=0)
    way = limit - np.median(near - middle * days[:, None], axis=0)
    with np.errstate(divide="ignore"):
        nights, earliest, latest = (np.maximum(way / one, 0.0) for one in (middle, high, low))
        return Forecast(nights, earliest, latest, low > 0.0, limit - way)


def bootstrapped(figures: FloatArray, limit: FloatArray) -> Forecast:
    """The same line over 40 tests; intervals from its residuals drawn again in blocks of 5 nights (Kunsch 1989)."""
    near = figures[-_BOOTSTRAPPED:]
    rng = np.random.default_rng(5)
    count, days = len(near), np.arange(1.0 - len(near), 1.0)
    slope = np.median(_pairs(near, days), axis=0)
    level = np.median(near - slope * days[:, None], axis=0)
    fitted = level + slope * days[:, None]
    rest = (near - fitted) * np.sqrt(count / (count - 2.0))
    blocks = -(-count // _BLOCK)
    again = []
    for _ in range(_RESAMPLES):
        starts = rng.integers(0, count - _BLOCK + 1, blocks)
        rows = (starts[:, None] + np.arange(_BLOCK)).ravel()[:count]
        # a least-squares line: the median of pairs of 60 resamples takes minutes
        per_day, now = np.polyfit(days, fitted + rest[rows], 1)
        again.append((per_day, now))
    drawn_slopes, drawn_levels = (np.array(one) for one in zip(*again, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        met = np.where(drawn_slopes > 0.0, np.maximum((limit - drawn_levels) / drawn_slopes, 0.0), np.inf)
        earliest, latest = np.quantile(met, (0.025, 0.975), axis=0, method="nearest")
        nights = np.maximum((limit - level) / slope, 0.0)
    return Forecast(nights, earliest, latest, np.quantile(drawn_slopes, 0.025, axis=0) > 0.0, level)


def local_trend(figures: FloatArray, limit: FloatArray) -> Forecast:
    """Level and slope that both wander (Harvey 1989), by a Kalman filter; noises averaged by their likelihood."""
    figures = figures[-90:]
    count, valves = figures.shape
    found = []
    for of_slope in (0.0, 1.0e-6, 1.0e-5, 1.0e-4, 1.0e-3):
        for of_level in (0.0, 0.03, 0.3):
            state = np.array([figures[0], np.zeros(valves)])
            spread, size, misfit = np.diag([1.0, 1.0e2]), 0.0, np.zeros(valves)
            step = np.array([[1.0, 1.0], [0.0, 1.0]])
            for night in range(1, count):
                state = step @ state
                spread = step @ spread @ step.T + np.diag([of_level, of_slope])
                ahead = spread[0, 0] + 1.0
                gain, miss = spread[:, 0] / ahead, figures[night] - state[0]
                state = state + gain[:, None] * miss
                spread = spread - np.outer(gain, spread[0])
                if night > 1:
                    size, misfit = size + np.log(ahead), misfit + miss**2 / ahead
            variance = misfit / (count - 2)
            likelihood = -0.5 * (size + (count - 2) * np.log(variance))
            found.append((likelihood, state, spread[:, :, None] * variance, of_level * variance, of_slope * variance))
    likelihoods = np.array([one[0] for one in found])
    weights = np.exp(likelihoods - likelihoods.max(axis=0))
    weights /= weights.sum(axis=0)
    states = np.array([one[1] for one in found])
    state = np.einsum("mf,mcf->cf", weights, states)
    apart = states - state
    spread_of = np.array([one[2] for one in found]) + apart[:, :, None] * apart[:, None, :]
    whole = 1.96**2 * np.einsum("mf,mcdf->cdf", weights, spread_of)
    more = [1.96**2 * np.sum(weights * np.array([one[place] for one in found]), axis=0) for place in (3, 4)]
    ahead_nights = np.concatenate((np.arange(0.0, 120.0, 1.0), np.arange(120.0, _FIVE_YEARS, 10.0)))[:, None]
    wide = whole[0, 0] + 2 * ahead_nights * whole[0, 1] + ahead_nights**2 * whole[1, 1]
    wide = np.sqrt(np.maximum(wide + ahead_nights * more[0] + ahead_nights**3 / 3.0 * more[1], 0.0))
    line = state[0] + ahead_nights * state[1]
    ends = []
    for border in (line, line + wide, line - wide):
        hits = border >= limit
        ends.append(np.where(hits.any(axis=0), ahead_nights[hits.argmax(axis=0), 0], np.inf))
    return Forecast(ends[0], ends[1], ends[2], state[1] > np.sqrt(whole[1, 1]), state[0])


METHODS: Final[Mapping[str, Method]] = {
    "Theil-Sen, ranks, 60 tests": theil_sen,
    "Theil-Sen, block bootstrap, 40": bootstrapped,
    "local trend, Kalman": local_trend,
    "line in wander, 60": line_in_wander(),
    "line in wander, 40": line_in_wander(40),
    "line in wander, 25": line_in_wander(25),
}
#: What is said of a change against the baseline, by the limit: the arrow in the list goes by the interval alone.
CHANGES: Final = {"friction up, limit 25 %": _LIMIT, "friction up, limit 8 %": 0.08, "beyond its interval": 0.0}
CHOSEN: Final = "line in wander, 60"


def _pairs(figures: FloatArray, days: FloatArray) -> FloatArray:
    first, second = np.triu_indices(len(figures), 1)
    return np.asarray((figures[second] - figures[first]) / (days[second] - days[first])[:, None])


def _met(level: FloatArray, per_day: FloatArray, variances: Sequence[FloatArray], limit: FloatArray) -> Forecast:
    """Return when the line and its band meet the limit, as ``Slope.reaches`` has it."""
    way, sure = limit - level, per_day > np.sqrt(variances[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        square = per_day**2 - variances[2]
        middle = (way * per_day + variances[1]) / square
        half = np.sqrt(np.maximum(middle**2 - (way**2 - variances[0]) / square, 0.0))
        met = (way / per_day, middle - half, middle + half)
        nights, earliest, latest = (np.maximum(one, 0.0) for one in met)
        return Forecast(nights, earliest, latest, sure, level)


def scatter(figures: FloatArray) -> FloatArray:
    """Standard deviation from night to night, as ``scatter_between`` has it."""
    if len(figures) < 8:
        return np.zeros(figures.shape[1])
    apart = np.concatenate([np.abs(figures[lag:] - figures[:-lag]) for lag in (1, 2, 3)])
    return np.asarray(1.4826 * np.median(apart, axis=0) / np.sqrt(2.0))


def told(
    forecast: Forecast, figures: FloatArray, half: FloatArray, limit: float = _LIMIT, share: float = TOLD
) -> Flags:
    """Whether health gives a night: the trend is sure, and its line beyond a share of the limit and beyond wander."""
    moved = forecast.level - figures[0]
    is_far = (moved > _reach(figures, half)) & (moved >= share * limit * figures[0])
    return np.asarray(forecast.sure & is_far & (forecast.nights <= 2.0 * _FIVE_YEARS))


def is_up(figures: FloatArray, half: FloatArray, limit: float = _LIMIT) -> Flags:
    """Whether health says that friction is up: beyond its limit and its interval."""
    moved = figures[-1] - figures[0]
    return np.asarray((moved > _reach(figures, half)) & (moved > limit * figures[0]))


def has_stepped(figures: FloatArray) -> Flags:
    """Whether health says that friction has risen: the newest tests lie above all before."""
    near = figures[-MOST_TESTS:]
    least = np.vstack((STEP * _LIMIT * figures[0], np.full(figures.shape[1], np.inf)))
    return np.asarray(steps_of(np.arange(1.0 - len(near), 1.0), near, least).tests > 0.0)


def is_forecast(forecast: Forecast, figures: FloatArray, half: FloatArray, share: float = BEYOND) -> Flags:
    """Whether health says that friction runs to its limit."""
    is_near = (forecast.nights <= _DAYS) & (forecast.latest <= LATEST * _DAYS)
    return np.asarray(told(forecast, figures, half, share=share) & is_near)


def _reach(figures: FloatArray, half: FloatArray) -> FloatArray:
    """How far two tests may differ: the baseline and the newest, each with the wander between tests."""
    wander = 1.96 * scatter(figures[-61:])
    return np.asarray(np.hypot(np.maximum(half * figures[0], wander), np.maximum(half * figures[-1], wander)))


def run(count: int | None = None) -> list[Table]:
    """Three tables: the nights that are forecast, alarms of valves without wear, nights until a rise is found."""
    return [_nights(), _alarms(VALVES if count is None else count), _found(VALVES if count is None else count)]


@dataclass(slots=True)
class _Judged:
    """Of all valve-nights with the limit at most 90 nights ahead: how many, how many with a forecast, and how good."""

    asked: int
    given: int
    held: int
    errors: list[float]
    widths: list[float]


def back_tested(
    law: str, methods: Mapping[str, Method], valves: int = _WORN, first_seed: int = 0
) -> dict[str, _Judged]:
    """Forecast each valve some 20 times on its way to the limit, over both durations and all wanders."""
    judged = {name: _Judged(0, 0, 0, [], []) for name in methods}
    for place, duration in enumerate(_DURATIONS):
        for forgotten in WANDERS.values():
            rng = np.random.default_rng((first_seed, place, int(forgotten)))
            nights = np.arange(duration, dtype=np.float64)
            figures, half = drawn(1.0 + _LIMIT * LAWS[law](nights / duration), valves, forgotten, rng)
            limit = (1.0 + _LIMIT) * figures[0]
            fine = np.linspace(0.0, 1.6 * duration, 4000)
            true = np.interp(limit, 1.0 + _LIMIT * LAWS[law](fine / duration), fine, right=np.inf)
            for night in range(_FROM_NIGHT, duration, max(1, duration // 20)):
                ahead = true - night
                live = (ahead > 0.0) & (ahead <= 90.0)
                for name, method in methods.items():
                    found = method(figures[: night + 1], limit)
                    given = live & told(found, figures[: night + 1], half)
                    one = judged[name]
                    one.asked += int(live.sum())
                    one.given += int(given.sum())
                    # a test a night: the limit is met between two of them
                    held = given & (found.earliest - 1.0 <= ahead) & (ahead <= found.latest + 1.0)
                    one.held += int(held.sum())
                    one.errors += list(np.abs(found.nights[given] - ahead[given]))
                    ends = np.minimum(found.latest, _FIVE_YEARS) - np.minimum(found.earliest, _FIVE_YEARS)
                    one.widths += list(ends[given])
    return judged


def _nights() -> Table:
    table = Table(
        title="The night of the limit, at most 90 nights ahead: nights with a forecast % / intervals that hold % / "
        "median error, nights / median length of the interval, nights",
        caption=f"{_WORN} valves a law, duration ({', '.join(map(str, _DURATIONS))} nights to the limit) and wander. "
        f"Health uses: {CHOSEN}.",
    )
    for heading in ("method", *LAWS):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    cells: defaultdict[str, list[str]] = defaultdict(list)
    for law in LAWS:
        for name, one in back_tested(law, METHODS).items():
            cells[name].append(
                f"{100.0 * one.given / one.asked:.0f} / {100.0 * one.held / max(one.given, 1):.0f} / "
                f"{np.median(one.errors or [np.nan]):.0f} / {np.median(one.widths or [np.nan]):.0f}"
            )
    for name, row in cells.items():
        table.add_row(name, *row)
    return table


def _per(alarms: int, nights: int) -> str:
    return f"none of {nights:,}" if alarms == 0 else f"1 in {nights / alarms:,.0f}"


def _alarms(valves: int) -> Table:
    table = Table(
        title=f"No wear: {valves:,} valves x {NIGHTS} nights, {100 * WANDER:g} % wander: wrong ones a valve-night",
        caption=f"Runs to its limit: state M, within {_DAYS:g} days.",
    )
    for heading in ("method", "statement", *WANDERS):
        table.add_column(heading, justify="left" if heading in ("method", "statement") else "right")
    rules = ("forecast in a year", "runs to its limit")
    counts: defaultdict[tuple[str, str], list[int]] = defaultdict(lambda: [0] * len(WANDERS))
    methods = {name: method for name, method in METHODS.items() if method is not local_trend}
    for column, forgotten in enumerate(WANDERS.values()):
        rng = np.random.default_rng((90, int(forgotten)))
        figures, half = drawn(np.ones(NIGHTS + 1), valves, forgotten, rng)
        for night in range(1, NIGHTS + 1):
            past = figures[: night + 1]
            for rule, limit in CHANGES.items():
                counts["change", rule][column] += int(is_up(past, half, limit).sum())
            counts["step", "friction has risen"][column] += int(has_stepped(past).sum())
            if night + 1 < LEAST_TESTS:
                continue
            for name, method in methods.items():
                if night % _SEEN and name != CHOSEN:
                    continue
                found = method(past, (1.0 + _LIMIT) * past[0])
                weight = 1 if name == CHOSEN else _SEEN
                said = (told(found, past, half) & (found.nights <= 365.0), is_forecast(found, past, half))
                for rule, one in zip(rules, said, strict=True):
                    counts[name, rule][column] += weight * int(one.sum())
    for (name, rule), row in counts.items():
        table.add_row(name, rule, *(_per(one, valves * NIGHTS) for one in row))
    return table


def _found(valves: int) -> Table:
    table = Table(
        title=f"A step after {_FIRST_NIGHTS} nights: nights until it is found, median / 90 % of the valves",
        caption="M: friction is up, or runs to its limit. A rise of 10 % is within the limit of 25 %: that rules M out "
        "by design. Rising: the trend is sure. Risen: the newest tests lie above all before.",
    )
    for heading in ("rise", "statement", *WANDERS):
        table.add_column(heading, justify="left" if heading in ("rise", "statement") else "right")
    rows: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    nights = 45
    for rise in (0.30, 0.10):
        for forgotten in WANDERS.values():
            rng = np.random.default_rng((30, int(forgotten)))
            truth = np.where(np.arange(_FIRST_NIGHTS + nights) < _FIRST_NIGHTS, 1.0, 1.0 + rise)
            figures, half = drawn(truth, valves, forgotten, rng)
            said: defaultdict[str, list[Flags]] = defaultdict(list)
            for night in range(_FIRST_NIGHTS, _FIRST_NIGHTS + nights):
                past = figures[: night + 1]
                found = METHODS[CHOSEN](past, (1.0 + _LIMIT) * past[0])
                said["M, limit 25 %"].append(is_up(past, half) | is_forecast(found, past, half))
                said["M, limit 8 %"].append(is_up(past, half, 0.08))
                said["change beyond its interval"].append(is_up(past, half, 0.0))
                said["trend: rising"].append(found.sure)
                said["step: risen"].append(has_stepped(past))
                said["step or trend"].append(found.sure | said["step: risen"][-1])
            for rule, one in said.items():
                hits = np.array(one)
                first = np.where(hits.any(axis=0), hits.argmax(axis=0) + 1.0, np.inf)
                ends = np.quantile(first, (0.5, 0.9), method="nearest")
                shown = ("never" if np.isinf(end) else f"{end:.0f}" for end in ends)
                rows[f"{100 * rise:.0f} %", rule].append(" / ".join(shown))
    for (size, rule), cells in rows.items():
        table.add_row(size, rule, *cells)
    return table
