"""Where the friction of a drive has a known sense: everywhere but where the stem may be at rest.

A stem rests only while |F - F_0| <= F_s (Karnopp 1985), and its friction then is anything up to F_s. Where the force
is beyond that the stem passes through zero speed at one instant, and its friction turns with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.moving_rows import MovingRows
from estimators.motion.windowed_slope import windowed_slope_noise
from estimators.samples import BoolArray, FloatArray, Samples

_SURE_SIGMAS: Final = 5.0  # of the windowed velocity's noise: slower is not told from rest
_NO_REST: Final = 2.0  # of F_c: static friction beyond that is not met, so the stem cannot rest under more force
_INSTANT_ROWS: Final = 0.5  # own choice: error of a reversal's instant that does no harm


@dataclass(frozen=True, slots=True, eq=False)
class Senses:
    """``sense`` (n,), -1 to 1, the mean over each row's period; ``unsure`` (n,) where the stem may be at rest."""

    sense: FloatArray
    unsure: BoolArray


def surely_moving(moving: MovingRows) -> Senses:
    """Return the senses with every slow row left out: what can be told before the friction is known."""
    unsure = widened(_turning(moving.sense.astype(np.float64)) | (moving.sense == 0), moving.half_window)
    return Senses(moving.sense.astype(np.float64), unsure)


def senses_by_force(
    samples: Samples, moving: MovingRows, force_n: FloatArray, mass_kg: float, coulomb_n: float
) -> Senses:
    """Return the senses where only possible rests are left out; ``force_n``, shape (n,), is F - F_0, smoothed.

    A row is open if its velocity may be zero within the velocity's window and its force lets the stem rest, or is too
    weak for the instant of a reversal to be found in the noise; so is a stay at zero speed that is too long to be a
    passage: beyond F_s the stem leaves with more than F_c / m.
    """
    velocity, half = moving.velocity, moving.half_window
    slow, passage_s = passage(samples, half, mass_kg, coulomb_n)
    still = np.abs(velocity) <= slow
    near_zero = widened(still | _turning(velocity), half)
    least_n = max(_NO_REST * coulomb_n, slow / _SURE_SIGMAS * mass_kg / (_INSTANT_ROWS * samples.period_s))
    unsure = near_zero & (np.abs(force_n) <= least_n)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if (end - first) * samples.period_s > passage_s:
            unsure[max(0, first - half) : end + half] = True
    # the friction's turn bends the motion: at that instant the windowed velocity is already ahead by this
    ahead = 2.0 * coulomb_n / mass_kg * samples.period_s * (2 * half + 1) / 12.0
    return Senses(_sense(velocity + ahead * np.sign(force_n) * near_zero), unsure)


def passage(samples: Samples, half_window: int, mass_kg: float, coulomb_n: float) -> tuple[float, float]:
    """Speed that is not told from rest, m/s, and the longest time that a passage through it takes, s.

    Beyond F_s the net force exceeds F_c once the stem moves (F_s is at least F_c, and 2 F_c is asked for).
    """
    slow = _SURE_SIGMAS * windowed_slope_noise(samples.position_noise_m, half_window, samples.period_s)
    return slow, 2.0 * slow * mass_kg / coulomb_n + (2 * half_window + 2) * samples.period_s


def widened(rows: BoolArray, reach: int) -> BoolArray:
    """Rows, shape (n,), within ``reach`` rows of one that is set."""
    before = np.concatenate([[0], np.cumsum(rows)])
    index = np.arange(rows.size)
    return np.asarray(before[np.minimum(index + reach + 1, rows.size)] > before[np.maximum(index - reach, 0)])


def _turning(velocity: FloatArray) -> BoolArray:
    """Rows on either side of a change of sign."""
    changes = velocity[1:] * velocity[:-1] < 0.0
    return np.asarray(np.concatenate([[False], changes]) | np.concatenate([changes, [False]]))


def _sense(velocity: FloatArray) -> FloatArray:
    """Mean of sgn v over each row's period, by the velocity drawn straight to the next row and the one before."""
    step = np.abs(np.gradient(velocity))
    quotient = np.divide(2.0 * velocity, step, out=np.sign(velocity), where=step > 0.0)
    return np.asarray(np.clip(quotient, -1.0, 1.0))
