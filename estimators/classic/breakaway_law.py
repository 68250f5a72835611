"""F_s as the law of breakaways: its mean, how much one differs from the next, and a first one that is harder."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.classic.force_windows import Leaving, RoughMotion
from estimators.classic.window_fit import Lag, WindowFit, fit_windows
from estimators.samples import FloatArray
from estimators.scatter import Measured

# Own choices, from rough valves (benchmark classic_rough).
_HARDER: Final = 4.5  # standard deviations by which the first breakaway exceeds the others
_OFF: Final = 5.0  # of the others: no breakaway of this law
_LEAST_SCATTER: Final = 0.01  # of F_s, below which no breakaway is told from the others
_FEWEST_TO_COMPARE: Final = 4
_DETECTION_S: Final = 2.0e-3  # of the instant: a sensor's filter, the creep below DV
_LEAST_ERROR: Final = 5.0e-4  # of F_s: what the creep below DV adds
_UNKNOWN_SCATTER: Final = 0.05  # of F_s, where there is one breakaway only
_ROUNDS: Final = 3
_OVERSHOOT: Final = 0.6  # of a jump, at most: a damping ratio above 0.16
_FEWEST_ENDS: Final = 3


@dataclass(frozen=True, slots=True)
class BreakawayLaw:
    """``static`` is the law's mean, N; ``scatter_n`` its standard deviation, None where none is seen beside errors.

    ``count`` breakaways took part; ``first_harder`` is by what share the first one was, None where it was not.
    """

    static: Measured
    scatter_n: float | None
    count: int
    first_harder: float | None

    def coulomb_of_jumps(self, ended: Measured | None) -> Measured:
        """F_c where a stem only jumps: a jump ends at F_c - e (F_s - F_c), with an overshoot e of 0 to 0.6."""
        if ended is None:
            return Measured(0.75 * self.static.value, 0.25 / math.sqrt(3.0) * self.static.value)
        most = _OVERSHOOT / (1.0 + _OVERSHOOT) * max(0.0, self.static.value - ended.value)
        return Measured(ended.value + 0.5 * most, ended.std_error, ended.freedom).with_error(most / math.sqrt(12.0))


def breakaway_law(
    leaving: Leaving, *, spring: float, preload: Measured, lag: Lag, period_s: float, local_share: float
) -> BreakawayLaw | None:
    """Return the law of these breakaways; None where there is none.

    ``lag`` is what the force is late by, ``local_share`` how rough the travel is by F_c: breakaways at the two ends
    of a stroke show the friction of two places only.
    """
    if leaving.count == 0:
        return None
    order = np.argsort(leaving.time_s)
    sense, rate = leaving.sense[order], np.abs(leaving.rate[order])
    held_n = sense * (leaving.force_n - spring * leaving.position_m - preload.value)[order] + lag.late_s * rate
    within_s, place_m = leaving.within_s[order], leaving.position_m[order]
    kept, harder = _like_the_others(held_n)
    held_n, rate, sense, within_s, place_m = (one[kept] for one in (held_n, rate, sense, within_s, place_m))
    believed_s = math.hypot(late_s(lag, period_s), float(np.median(within_s)))
    open_n = rate * period_s / math.sqrt(12.0)
    count = int(held_n.size)
    level_n = abs(float(np.median(held_n)))
    if count == 1:
        spread = _UNKNOWN_SCATTER * level_n
        static = Measured(float(held_n[0]), spread).with_error(float(rate[0]) * believed_s)
        return BreakawayLaw(static.with_error(preload.std_error), None, 1, harder)
    # what is open of the instants is a force by the rate: the sensors' lags are fitted beside a belief of them
    matrix = np.column_stack([np.ones(count), rate])
    spread = max(float(np.std(held_n, ddof=1)), 1.0e-6 * level_n)
    value, opened, inverse = level_n, 0.0, np.eye(2)
    for _ in range(_ROUNDS):
        weight = 1.0 / (spread**2 + open_n**2)
        normal = (matrix * weight[:, None]).T @ matrix
        normal[1, 1] += 1.0 / believed_s**2
        inverse = np.linalg.inv(normal)
        solved = inverse @ ((matrix * weight[:, None]).T @ held_n)
        value = float(solved[0])
        away = held_n - matrix @ solved
        seen = float(np.sum(weight * away**2) / np.sum(weight)) * count / (count - 1)
        opened = float(np.sum(weight * open_n**2) / np.sum(weight))
        spread = math.sqrt(max(seen - opened, (1.0e-6 * level_n) ** 2))
    static = Measured(value, math.sqrt(float(inverse[0, 0])), float(count - 1))
    static = static.with_error(abs(float(np.mean(sense))) * preload.std_error)
    static = static.with_error(_LEAST_ERROR * value)
    static = static.with_error(local_share * value / math.sqrt(_places(place_m, sense)))
    scatter = spread if spread > max(1.0e-4 * level_n, math.sqrt(opened / count)) else None
    return BreakawayLaw(static, scatter, count, harder)


def late_s(lag: Lag, period_s: float) -> float:
    """What the instants of all breakaways may be late by, s, one standard deviation."""
    return math.hypot(lag.error_s, _DETECTION_S, 0.3 * period_s)


def _like_the_others(held_n: FloatArray) -> tuple[np.ndarray, float | None]:
    """Which breakaways (n,) are of one law, and by what share the first one is harder than the others."""
    kept = np.ones(held_n.size, dtype=np.bool_)
    harder = None
    if held_n.size < _FEWEST_TO_COMPARE:
        return kept, harder
    others = held_n[1:]
    middle = float(np.median(others))
    least = _LEAST_SCATTER * abs(middle)
    spread = max(float(np.std(others, ddof=1)), least)
    if held_n[0] > middle + _HARDER * spread:
        harder = float(held_n[0] / middle - 1.0)
        kept[0] = False
    robust = max(1.4826 * float(np.median(np.abs(held_n[kept] - middle))), least)
    return kept & (np.abs(held_n - middle) <= _OFF * robust), harder


def _places(place_m: FloatArray, sense: FloatArray) -> int:
    """How many places the breakaways were at, by direction, a twentieth of the way between them apart."""
    span = max(float(np.ptp(place_m)), 1.0e-12)
    return len({(float(s), round(20.0 * float(p - place_m.min()) / span)) for p, s in zip(place_m, sense, strict=True)})


@dataclass(frozen=True, slots=True, eq=False)
class JumpFit:
    """The fit of (k, F_0, F_s, end of a jump) to where jumps begin and end; the last one where ends are seen.

    Arrays (n,) of its rows: stroke, sense, place and the force's rate, N/s.
    """

    fit: WindowFit
    has_ends: bool
    stroke: FloatArray
    sense: FloatArray
    position_m: FloatArray
    rate: FloatArray

    def late_n(self, late_s: float) -> FloatArray:
        """How far the coefficients (p,) are off where all instants are late by this: a force by the ramps' rates."""
        fit, kept = self.fit, self.fit.kept
        weighted = (fit.through * fit.weight[:, None])[kept]
        return np.asarray(late_s * np.linalg.pinv(weighted.T @ fit.matrix[kept]) @ (weighted.T @ self.rate[kept]))


def law_of_jumps(rough: RoughMotion, *, sprung: bool) -> JumpFit | None:
    """Return what the jumps of a stem say that never slides; None where too few are seen."""
    leaving, stopping = rough.leaving, rough.stopping
    if leaving.count < _FEWEST_TO_COMPARE or np.unique(leaving.sense).size < 2:
        return None
    ends = stopping.count >= _FEWEST_ENDS
    parts = (leaving, stopping) if ends else (leaving,)
    position_m = np.concatenate([one.position_m for one in parts])
    sense = np.concatenate([one.sense for one in parts])
    force_n = np.concatenate([one.force_n for one in parts])
    stroke = np.concatenate([one.stroke for one in parts]).astype(np.float64)
    is_end = np.concatenate([np.full(one.count, float(number)) for number, one in enumerate(parts)])
    columns = [position_m] if sprung else []
    columns += [np.ones(sense.size), sense * (1.0 - is_end)]
    if ends:
        columns.append(sense * is_end)
    fit = fit_windows(np.column_stack(columns), force_n, np.ones(sense.size))
    rate = np.concatenate([one.rate for one in parts])
    return None if fit is None else JumpFit(fit, ends, stroke, sense, position_m, rate)
