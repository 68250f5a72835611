"""The latent friction on knots: along the travel for each direction, and in time; its prior and its columns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.linalg import cho_factor

from estimators.engine.roughness import ROUGH, Roughness, travel_correlation
from estimators.linear_fit import inverse_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Reader = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

# Lines between knots h apart leave 0.25 (1.7 h / length)^1.5 of the friction's size: where that is far above the noise
# it looks like other dynamics, and m and F_v come out wrong (make bench ARGS=rough_valves, with 3 knots everywhere).
_FEWEST_KNOTS_A_LENGTH: Final = 3.0
_MOST_KNOTS_A_LENGTH: Final = 5.0
_LEFT_BY_LINES: Final = 0.25
_MOST_TRAVEL_KNOTS: Final = 280
_MOST_TIME_KNOTS: Final = 160
_TIME_KNOT_S: Final = 0.3
_JITTER: Final = 1.0e-5  # of the variance: what keeps a smooth prior's inverse from rounding


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Knots over travel (m, the same for both directions) and in time (s), and the precision of all their values.

    The values are ordered: opening, closing, in time.
    """

    travel_m: FloatArray
    time_s: FloatArray
    precision: FloatArray
    log_determinant: float  # of the precision
    roughness: Roughness | None = None
    smoothness: int = ROUGH

    @property
    def count(self) -> int:
        """Number of values."""
        return 2 * self.travel_m.size + self.time_s.size

    def beside(self, travel_m: FloatArray, time_s: FloatArray, opening: BoolArray) -> tuple[IntArray, FloatArray]:
        """Return the four values between which friction lies at n places and times, and their shares, shape (n, 4).

        ``travel_m``, ``time_s`` and ``opening``, whether the stem opens: shape (n,). Shape (n, 0) without knots.
        """
        travel = self.travel_m.size
        if travel == 0:
            return np.empty((travel_m.size, 0), np.int64), np.empty((travel_m.size, 0))
        along, share = between(self.travel_m, travel_m)
        in_time, share_of_time = between(self.time_s, time_s)
        along, in_time = along + np.where(opening, 0, travel), in_time + 2 * travel
        return (
            np.column_stack([along, along + 1, in_time, in_time + 1]),
            np.column_stack([1.0 - share, share, 1.0 - share_of_time, share_of_time]),
        )

    def within(self, spans_s: list[tuple[float, float]]) -> Fields:
        """Return the fields with the knots in time in these spans alone: an Ornstein-Uhlenbeck process on fewer knots.

        What is said of the friction there is the same.
        """
        if self.roughness is None:
            return self
        inside = np.any([(self.time_s >= first) & (self.time_s <= last) for first, last in spans_s], axis=0)
        return fields_on(self.travel_m, self.time_s[inside], self.roughness, self.smoothness)

    def taken_from(self, fewer: Fields, values: FloatArray) -> FloatArray:
        """Return values from those of the fields on fewer knots in time, straight lines between them.

        ``values``: shape (f,), N.
        """
        if self.time_s.size == fewer.time_s.size:
            return values
        travel = 2 * self.travel_m.size
        return np.concatenate([values[:travel], np.interp(self.time_s, fewer.time_s, values[travel:])])

    def friction_n(
        self, travel_m: FloatArray, time_s: FloatArray, opening: BoolArray, values: FloatArray
    ) -> FloatArray:
        """Return what friction with these values has beside its mean at places and times, N, shape (n,).

        ``values``: shape (f,), N.
        """
        travel = self.travel_m.size
        if travel == 0:
            return np.zeros(travel_m.size)
        own = self._of_direction(np.interp, travel_m, opening, values)
        return own + np.interp(time_s, self.time_s, values[2 * travel :])

    @property
    def left_by_lines_n(self) -> float:
        """How much of the friction lines between the knots leave, N.

        Nothing of one that has come to vary between the knots: it stands in for what is no friction.
        """
        if self.roughness is None or self.travel_m.size < 2:
            return 0.0
        size_n = math.sqrt(2.0) * math.hypot(self.roughness.common_n, self.roughness.own_n)
        share = math.sqrt(3.0) * float(self.travel_m[1] - self.travel_m[0]) / self.roughness.length_m
        return float(_LEFT_BY_LINES * share**1.5 * size_n) if share < 1.0 else 0.0

    def slope_n_per_m(self, travel_m: FloatArray, opening: BoolArray, values: FloatArray) -> FloatArray:
        """By how much friction with these values rises along the travel, N/m, shape (n,).

        ``travel_m`` and ``opening``: shape (n,); ``values``: shape (f,), N.
        """
        if self.travel_m.size < 2:
            return np.zeros(travel_m.size)
        return self._of_direction(_slope, travel_m, opening, values)

    def _of_direction(self, read: Reader, travel_m: FloatArray, opening: BoolArray, values: FloatArray) -> FloatArray:
        travel = self.travel_m.size
        out = np.empty(travel_m.size)
        for own, moving in ((values[:travel], opening), (values[travel : 2 * travel], ~opening)):
            out[moving] = read(travel_m[moving], self.travel_m, own)
        return out


@njit(cache=True, error_model="numpy")
def between(knots: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """The knot before each place, and how much of the next one there is in a line between them, shape (n,).

    ``knots``, two at least, and ``at``, shape (n,), are in one unit, m or s.
    """
    left, share = np.empty(at.size, np.int64), np.empty(at.size)
    for place in range(at.size):
        before = min(max(np.searchsorted(knots, at[place], side="right") - 1, 0), knots.size - 2)
        left[place] = before
        share[place] = min(max((at[place] - knots[before]) / (knots[before + 1] - knots[before]), 0.0), 1.0)
    return left, share


def _slope(at: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Slopes of the lines between knots, none beyond them, shape (n,)."""
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    inside = (at >= knots[0]) & (at <= knots[-1])
    return np.where(inside, (np.diff(values) / np.diff(knots))[left], 0.0)


def no_fields() -> Fields:
    """Return the friction of an ideal packing: it varies nowhere."""
    return Fields(np.empty(0), np.empty(0), np.empty((0, 0)), 0.0)


def knots_a_length(size_n: float, noise_n: float) -> float:
    """Return how many knots a length of the roughness leave no more than this of friction of this size, N."""
    needed = math.sqrt(3.0) * math.pow(_LEFT_BY_LINES * size_n / max(noise_n, 1.0e-12), 2.0 / 3.0)
    return min(max(needed, _FEWEST_KNOTS_A_LENGTH), _MOST_KNOTS_A_LENGTH)


def fields_over(
    travel_m: tuple[float, float],
    spans_s: list[tuple[float, float]],
    roughness: Roughness,
    smoothness: int,
    knots: float = _FEWEST_KNOTS_A_LENGTH,
) -> Fields:
    """Return the fields over this travel and these spans of time in which the stem moves, ``knots`` a length."""
    low_m, high_m = travel_m
    step_m = max(roughness.length_m / knots, (high_m - low_m) / _MOST_TRAVEL_KNOTS)
    places_m = np.linspace(low_m, high_m, max(2, math.ceil((high_m - low_m) / step_m) + 1))
    moving_s = sum(last - first for first, last in spans_s)
    step_s = max(_TIME_KNOT_S, moving_s / _MOST_TIME_KNOTS)
    time_s = np.unique(np.concatenate([np.linspace(a, b, max(2, math.ceil((b - a) / step_s) + 1)) for a, b in spans_s]))
    time_s = time_s[np.concatenate([[True], np.diff(time_s) > 1.0e-6])]
    return fields_on(places_m, time_s, roughness, smoothness)


def fields_on(travel_m: FloatArray, time_s: FloatArray, roughness: Roughness, smoothness: int) -> Fields:
    """Return the fields on these knots; ``travel_m``: shape (n_knots,), ``time_s``: shape (n_times,)."""
    along = travel_correlation(travel_m, roughness.length_m, smoothness)[0] + _JITTER * np.eye(travel_m.size)
    lower = cho_factor(along, lower=True, check_finite=False)[0]
    inverse, log_along = inverse_of(lower), 2.0 * float(np.log(np.diag(lower)).sum())
    # opening and closing are common +- own: their sum and difference are independent
    of_sum = 2.0 * roughness.common_n**2 + roughness.own_n**2
    of_difference = roughness.own_n**2
    same = 0.5 * inverse * (1.0 / of_sum + 1.0 / of_difference)
    other = 0.5 * inverse * (1.0 / of_sum - 1.0 / of_difference)
    count = travel_m.size
    precision = np.zeros((2 * count + time_s.size,) * 2)
    precision[:count, :count] = precision[count : 2 * count, count : 2 * count] = same
    precision[:count, count : 2 * count] = precision[count : 2 * count, :count] = other
    logarithm = -2.0 * log_along - count * (math.log(of_sum) + math.log(of_difference))
    wander, log_wander = wander_precision(time_s, roughness)
    precision[2 * count :, 2 * count :] = wander
    return Fields(travel_m, time_s, precision, logarithm + log_wander, roughness, smoothness)


def wander_precision(time_s: FloatArray, roughness: Roughness) -> tuple[FloatArray, float]:
    """Return the precision of an Ornstein-Uhlenbeck process at these times, tridiagonal, and its log determinant.

    ``time_s``: shape (n,).
    """
    variance = roughness.wander_n**2
    kept = np.exp(-np.diff(time_s) / roughness.wander_s)
    new = variance * -np.expm1(2.0 * np.log(np.maximum(kept, 1.0e-300)))
    out = np.zeros((time_s.size, time_s.size))
    index = np.arange(time_s.size)
    out[0, 0] = 1.0 / variance
    out[index[1:], index[1:]] += 1.0 / new
    out[index[:-1], index[:-1]] += kept**2 / new
    out[index[1:], index[:-1]] = out[index[:-1], index[1:]] = -kept / new
    return out, -math.log(variance) - float(np.log(new).sum())
