"""Static friction between the treads of a stepped force: each breakaway is known to lie between two forces.

While a stem rests, the largest force that did not move it is below the force of that breakaway, and the step that moved
it was enough. With F_s (1 + z), z normal, each breakaway adds the probability of its bracket to the likelihood (a
normal sample censored to intervals); forces that never moved the stem add a bound from below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import log_ndtr, ndtr

from estimators.base import NORMAL_95
from estimators.engine.balance import Balance
from estimators.engine.breakaways import StaticFriction
from estimators.engine.stepped import Held, Stepped
from estimators.samples import FloatArray

_VALUES: Final = 801
_USUAL_SCATTER, _SCATTER_SPREAD = 0.015, 1.5  # of F_s: the median of what packings have, and of its logarithm
_SCATTERS: Final = 25
_WIDEST: Final = 3.0  # standard deviations of the scatter's logarithm that are tried
_BEYOND: Final = 0.3  # of the largest bracket: how far F_s is looked for
_LEAST: Final = 1.0e-300


@dataclass(frozen=True, slots=True, eq=False)
class Brackets:
    """Forces between which a stem broke away, N, shape (n,), the second infinite where nothing moved it.

    ``error_n`` is how well each is known by the spring and the preload.
    """

    low_n: FloatArray
    high_n: FloatArray
    error_n: FloatArray


def brackets(found: Stepped, balance: Balance, on_stop: tuple[Held, ...] = ()) -> Brackets:
    """Return the brackets of a recording's rests, both directions of each; what holds a stem on a stop is left out."""
    values, joint = balance.values, balance.joint
    rows: list[tuple[float, float, float]] = []

    def net(force_n: float, place_m: float, sign: float) -> float:
        return sign * (force_n - float(values[0]) * place_m - float(values[1]))

    def error(place_m: float) -> float:
        slopes = np.array([place_m, 1.0])
        return math.sqrt(max(float(slopes @ joint[:2, :2] @ slopes), 0.0))

    held_n: dict[float, float] = {}
    level_m, rests, outwards = math.nan, True, 0.0
    for one in found.held:
        if math.isnan(level_m):
            level_m = one.answer.start_m
            held_n = {way: net(one.before_n, level_m, way) for way in (1.0, -1.0)}
        if not one.answer.moved:
            rests = rests or one.answer.settled
            held_n = {way: max(most_n, net(one.after_n, level_m, way)) for way, most_n in held_n.items()}
            continue
        if rests:  # a stem that was still sliding did not break away
            rows.append((held_n[one.sign], net(one.after_n, level_m, one.sign), error(level_m)))
            if -one.sign != outwards:
                rows.append((held_n[-one.sign], math.inf, error(level_m)))
        level_m, rests, outwards = one.answer.end_m, one.answer.settled, one.sign if one in on_stop else 0.0
        held_n = {way: net(one.after_n, level_m, way) for way in (1.0, -1.0)}
    if rests:
        rows += [(low_n, math.inf, error(level_m)) for way, low_n in held_n.items() if way != outwards]
    table = np.array(rows).reshape(-1, 3)
    return Brackets(*np.ascontiguousarray(table[table[:, 1] > table[:, 0]].T))


def static_friction_between(found: Brackets, balance: Balance) -> StaticFriction | None:
    """Return F_s by its brackets, None where no breakaway has one.

    Its standard error is not below that of the usual bracket, uniform within, over the root of their number.
    """
    closed = np.isfinite(found.high_n)
    count = int(closed.sum())
    coulomb = balance.known("F_c")
    if count == 0 or coulomb.value <= 0.0:
        return None
    low_n = max(0.5 * coulomb.value, 1.0e-9)
    highest_n = float(found.high_n[closed].max())
    if highest_n <= low_n:
        return None
    static_n = np.linspace(low_n, (1.0 + _BEYOND) * highest_n, _VALUES)
    spreads = np.linspace(-_WIDEST, _WIDEST, _SCATTERS)
    shares = _USUAL_SCATTER * np.exp(_SCATTER_SPREAD * spreads)
    surprise = np.zeros((_VALUES, _SCATTERS))
    for low, high, error in zip(found.low_n, found.high_n, found.error_n, strict=True):
        width = np.hypot(static_n[:, None] * shares, error)
        above = (low - static_n[:, None]) / width
        if math.isinf(high):
            surprise -= log_ndtr(-above)
        else:
            surprise -= np.log(np.maximum(ndtr((high - static_n[:, None]) / width) - ndtr(above), _LEAST))
    surprise -= log_ndtr((static_n - coulomb.value) / max(coulomb.std_error, 1.0e-9))[:, None]
    surprise += 0.5 * spreads**2
    weight = np.exp(surprise.min() - surprise)
    weight /= weight.sum()
    of_static = weight.sum(axis=1)
    mean_n = float(of_static @ static_n)
    error_n = math.sqrt(float(of_static @ (static_n - mean_n) ** 2))
    tread_n = float(np.median((found.high_n - np.maximum(found.low_n, coulomb.value))[closed]))
    least_n = max(tread_n, 0.0) / math.sqrt(12.0 * count)
    ends_n = np.interp([0.025, 0.975], np.cumsum(of_static), static_n)
    half_n = NORMAL_95 * max(least_n, 1.0e-9)
    interval_n = (min(float(ends_n[0]), mean_n - half_n), max(float(ends_n[1]), mean_n + half_n))
    return StaticFriction(mean_n, max(error_n, least_n), interval_n, None, count)
