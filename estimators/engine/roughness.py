"""How friction varies beside its mean: along the travel, in each direction its own part, and slowly in time.

Friction while the stem moves with sign s is F_c + w_s(x) + d(t). The fields w are Gaussian processes over the travel
(of the smoothness that explains the recording best) with a part that both directions share and one of each
direction's own; d is an Ornstein-Uhlenbeck process in time. Their sizes and lengths are hyperparameters, found from
the recording itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import minimize

FloatArray = npt.NDArray[np.float64]
Sizes = tuple[float, float, float, float, float]
Places = tuple[FloatArray, FloatArray, FloatArray]

# How smooth friction is along the travel: exponential, Matern 3/2, and Gaussian correlation.
EDGED: Final = 0
ROUGH: Final = 1
SMOOTH: Final = 2
HYPERPARAMETERS: Final = ("common", "own", "length", "wander", "wander_time", "error")


@dataclass(frozen=True, slots=True)
class Roughness:
    """Sizes (standard deviations, N), the length over travel (m), the time of the wander (s).

    ``error_n`` is what is left from block to block and belongs to no field.
    """

    common_n: float
    own_n: float
    length_m: float
    wander_n: float
    wander_s: float
    error_n: float

    def logarithms(self) -> FloatArray:
        """Return the logarithms in the order of HYPERPARAMETERS."""
        return np.log([self.common_n, self.own_n, self.length_m, self.wander_n, self.wander_s, self.error_n])


# What packings have (sources in docs/methods.md): medians and spreads of logarithms, sizes in shares of F_c.
_SHARES: Final = {"common": 0.007, "own": 0.007, "wander": 0.004, "error": 0.001}
_SPREADS: Final = {"common": 2.0, "own": 2.0, "length": 0.8, "wander": 2.0, "wander_time": 1.0, "error": 3.0}
_ALIKE: Final = 0.7  # spread of the logarithm of common over own
_MOST_GROWTH: Final = math.log(3.0)
_LENGTH: Final = 0.025  # of the travel
_WANDER_S: Final = 20.0
_SHORTEST_WANDER_S: Final = 5.0  # temperature, grease and debris take longer
_LOWEST_SHARE: Final = 1.0e-6
_HIGHEST_SHARE: Final = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class RoughnessPrior:
    """What is known of a packing's roughness beforehand: medians of the logarithms in the order of HYPERPARAMETERS."""

    middle: FloatArray
    spread: FloatArray
    low: FloatArray
    high: FloatArray

    def near(self, roughness: Roughness) -> RoughnessPrior:
        """Return it with sizes that are not far above those that the balance of forces saw.

        Roughness that may grow without limit explains a wrong motion, and then keeps it.
        """
        seen = roughness.logarithms()
        high = self.high.copy()
        for at in (HYPERPARAMETERS.index(name) for name in ("common", "own", "wander")):
            high[at] = min(high[at], max(seen[at] + _MOST_GROWTH, self.middle[at]))
        return RoughnessPrior(self.middle, self.spread, self.low, high)

    def squares(self, logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Return the sum of squares of what is away from it, and half of its slope, shape (c,).

        ``logarithms``: the first c of HYPERPARAMETERS, shape (c,).
        """
        count = logarithms.size
        away = (logarithms - self.middle[:count]) / self.spread[:count]
        slope = away / self.spread[:count]
        # what is alike both ways and what is not are of one kind: neither is far larger
        ratio = float(logarithms[0] - logarithms[1]) / _ALIKE
        slope[:2] += np.array([1.0, -1.0]) * ratio / _ALIKE
        return float(away @ away) + ratio**2, slope

    def lowest(
        self,
        surprise: Callable[[FloatArray], tuple[float, FloatArray]],
        start: FloatArray,
        search: Mapping[str, Any],
    ) -> tuple[float, FloatArray]:
        """Return the least of a surprise and half of the squares inside the bounds, and where it is, shape (c,).

        ``surprise`` gives its value and its slope, shape (c,), at the first c logarithms; ``start`` are those to begin
        at, ``search`` the options of L-BFGS-B.
        """

        def both(at: FloatArray) -> tuple[float, FloatArray]:
            value, slope = surprise(at)
            squares, own = self.squares(at)
            return value + 0.5 * squares, slope + own

        bounds = list(zip(self.low[: start.size], self.high[: start.size], strict=True))
        options: Any = search
        found = minimize(both, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        return float(found.fun), np.asarray(found.x)


def roughness_prior(friction_n: float, travel_m: float) -> RoughnessPrior:
    """Return what is known of the roughness of a packing with this friction and travel."""
    middle = np.log(
        [
            _SHARES["common"] * friction_n,
            _SHARES["own"] * friction_n,
            _LENGTH * travel_m,
            _SHARES["wander"] * friction_n,
            _WANDER_S,
            _SHARES["error"] * friction_n,
        ]
    )
    low, high = math.log(_LOWEST_SHARE * friction_n), math.log(_HIGHEST_SHARE * friction_n)
    return RoughnessPrior(
        middle,
        np.array([_SPREADS[name] for name in HYPERPARAMETERS]),
        np.array([low, low, middle[2] - 1.6, low, math.log(_SHORTEST_WANDER_S), low]),
        np.array([high, high, middle[2] + 1.6, high, math.log(200.0), high]),
    )


def roughness_of(logarithms: FloatArray) -> Roughness:
    """Return what these logarithms, shape (6,), in the order of HYPERPARAMETERS, stand for."""
    return Roughness(*(float(value) for value in np.exp(logarithms)))


@njit(cache=True, error_model="numpy")
def _correlation(away: float, smoothness: int) -> tuple[float, float]:
    """Correlation at this many lengths, and its slope by the logarithm of the length."""
    if smoothness == ROUGH:
        z = math.sqrt(3.0) * away
        return (1.0 + z) * math.exp(-z), z * z * math.exp(-z)
    if smoothness == EDGED:
        return math.exp(-away), away * math.exp(-away)
    z = 0.5 * away * away
    return math.exp(-z), 2.0 * z * math.exp(-z)


@njit(cache=True, error_model="numpy")
def _covariance(
    travel_m: FloatArray, time_s: FloatArray, direction: FloatArray, sizes: Sizes, smoothness: int
) -> FloatArray:
    """Covariance of the variation times its direction at places and times."""
    common, own, length_m, wander, wander_s = sizes
    n = travel_m.size
    out = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            along = _correlation(abs(travel_m[i] - travel_m[j]) / length_m, smoothness)[0]
            sign = direction[i] * direction[j]
            fades = math.exp(-abs(time_s[i] - time_s[j]) / wander_s)
            out[i, j] = out[j, i] = sign * ((common + (own if sign > 0.0 else 0.0)) * along + wander * fades)
    return out


@njit(cache=True, error_model="numpy")
def _slopes(places: Places, sizes: Sizes, smoothness: int, weight: FloatArray) -> FloatArray:
    """Sums of the weights times the covariance's slopes by the logarithms of its five hyperparameters."""
    travel_m, time_s, direction = places
    common, own, length_m, wander, wander_s = sizes
    n = travel_m.size
    by_common = by_own = by_length = by_wander = by_time = 0.0
    for i in range(n):
        for j in range(i + 1):
            sign = direction[i] * direction[j]
            weighed = sign * weight[i, j] * (1.0 if i == j else 2.0)
            along, slope = _correlation(abs(travel_m[i] - travel_m[j]) / length_m, smoothness)
            age = abs(time_s[i] - time_s[j]) / wander_s
            fades = math.exp(-age)
            by_common += weighed * along
            by_length += weighed * common * slope
            if sign > 0.0:
                by_own += weighed * along
                by_length += weighed * own * slope
            by_wander += weighed * fades
            by_time += weighed * age * fades
    return np.array(
        [2.0 * common * by_common, 2.0 * own * by_own, by_length, 2.0 * wander * by_wander, wander * by_time]
    )


def _sizes(roughness: Roughness) -> Sizes:
    """Variances of what is common, own and wandering, each with its length."""
    return roughness.common_n**2, roughness.own_n**2, roughness.length_m, roughness.wander_n**2, roughness.wander_s


def _contiguous(travel_m: FloatArray, time_s: FloatArray, direction: FloatArray) -> Places:
    """The same as the kernels were compiled for: for a view they would be once more, in seconds."""
    return np.ascontiguousarray(travel_m), np.ascontiguousarray(time_s), np.ascontiguousarray(direction)


def field_covariance(
    travel_m: FloatArray, time_s: FloatArray, direction: FloatArray, roughness: Roughness, smoothness: int
) -> FloatArray:
    """Return the covariance of s (w_s(x) + d(t)) at places, shape (n, n), N^2.

    ``travel_m``, ``time_s`` and ``direction``: shape (n,), SI.
    """
    places = _contiguous(travel_m, time_s, direction)
    return np.asarray(_covariance(*places, _sizes(roughness), smoothness))


def field_slopes(
    travel_m: FloatArray,
    time_s: FloatArray,
    direction: FloatArray,
    roughness: Roughness,
    smoothness: int,
    *,
    weight: FloatArray,
) -> FloatArray:
    """Return the sums of weights times the covariance's slopes by the first five logarithms, shape (5,), N^2.

    ``weight``: shape (n, n), symmetric. The slope by ``error`` is left to the caller: it is no part of the field.
    """
    places = _contiguous(travel_m, time_s, direction)
    return np.asarray(_slopes(places, _sizes(roughness), smoothness, weight))


@njit(cache=True, error_model="numpy")
def _correlations(travel_m: FloatArray, length_m: float, smoothness: int) -> tuple[FloatArray, FloatArray]:
    """Correlations over travel and their slopes by ln length, shape (n, n)."""
    n = travel_m.size
    along, slope = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            value, change = _correlation(abs(travel_m[i] - travel_m[j]) / length_m, smoothness)
            along[i, j] = along[j, i] = value
            slope[i, j] = slope[j, i] = change
    return along, slope


def travel_correlation(travel_m: FloatArray, length_m: float, smoothness: int) -> tuple[FloatArray, FloatArray]:
    """Return the correlation of friction at places in one direction, and its slope by ln length, shape (n, n)."""
    return _correlations(travel_m, length_m, smoothness)
