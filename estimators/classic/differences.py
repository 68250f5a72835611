"""Backward differences as the paper takes them, what noise does to them, and how their bias is undone.

On an affine force a moving stem is x = affine + c1 exp(l1 t) + c2 exp(l2 t), with m l^2 + F_v l + k = 0. The backward
difference of exp(l t) is s exp(l t), s = (1 - exp(-l T)) / T. A fit to differences therefore finds the m^ and F_v^
of m^ s^2 + F_v^ s + k = 0: biased, and exactly invertible.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from estimators.samples import FloatArray, Samples


def backward_differences(samples: Samples) -> tuple[FloatArray, FloatArray]:
    """Velocity (m/s) and acceleration (m/s2) by backward differences, shape (n,); NaN at the start of a run."""
    velocity = np.full(samples.count, np.nan)
    acceleration = np.full(samples.count, np.nan)
    time_s = samples.time_s
    velocity[1:] = np.diff(samples.position_m) / np.diff(time_s)
    acceleration[2:] = np.diff(velocity[1:]) / (0.5 * (time_s[2:] - time_s[:-2]))
    index = np.arange(samples.count)
    velocity[index < samples.run_first + 1] = np.nan
    acceleration[index < samples.run_first + 2] = np.nan
    return velocity, acceleration


def noise_covariance(noise_m: float, period_s: float) -> FloatArray:
    """Covariance of the noise in (acceleration, velocity, position) of one sample, shape (3, 3).

    White position noise sigma through (1, -2, 1)/T^2, (1, -1)/T and 1: 6 sigma^2/T^4 for the acceleration.
    """
    a = np.array([1.0, -2.0, 1.0]) / period_s**2
    v = np.array([1.0, -1.0, 0.0]) / period_s
    x = np.array([1.0, 0.0, 0.0])
    weights = np.stack([a, v, x])
    return np.asarray(noise_m**2 * (weights @ weights.T))


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Mass (kg), viscous friction (N s/m) and the two rates (1/s, slow one first) that they make with the spring."""

    mass_kg: float
    viscous_n_s_per_m: float
    rates_per_s: tuple[complex, complex]

    @property
    def slow_s(self) -> float:
        """Sum of the time constants, s: F_v/k, how long a transient lasts."""
        return sum(1.0 / abs(rate) for rate in self.rates_per_s)

    @property
    def fast_s(self) -> float:
        """Shorter time constant, s."""
        return 1.0 / max(abs(rate) for rate in self.rates_per_s)


def without_bias(mass_kg: float, viscous_n_s_per_m: float, spring_n_per_m: float, period_s: float) -> Dynamics | None:
    """Undo the bias of backward differences: the m and F_v behind the fitted m^ and F_v^; None where there are none.

    s1, s2 solve m^ s^2 + F_v^ s + k = 0; l = -ln(1 - s T)/T; m = k / (l1 l2), F_v = -m (l1 + l2).
    """
    if not (mass_kg > 0.0 and spring_n_per_m >= 0.0):
        return None
    # F_v^ may be negative: the bias of a lightly damped stem exceeds its F_v
    root = cmath.sqrt(viscous_n_s_per_m**2 - 4.0 * mass_kg * spring_n_per_m)
    twice = viscous_n_s_per_m + (root if viscous_n_s_per_m > 0.0 else -root)
    if twice == 0.0:
        return None
    fast, slow = -twice / (2.0 * mass_kg), -2.0 * spring_n_per_m / twice
    if max(fast.real, slow.real) * period_s >= 1.0:
        return None  # grows faster than differences can tell
    rate_fast = _rate(fast, period_s)
    if spring_n_per_m == 0.0:
        if not rate_fast.real < 0.0:
            return None
        # no spring: s1 = l1 = 0, and what is left is m^ s + F_v^ = 0 at the same F_v
        return Dynamics(viscous_n_s_per_m / -rate_fast.real, viscous_n_s_per_m, (rate_fast, rate_fast))
    rate_slow = _rate(slow, period_s)
    product, total = (rate_slow * rate_fast).real, (rate_slow + rate_fast).real
    if not (product > 0.0 and total < 0.0):
        return None
    true_mass = spring_n_per_m / product
    return Dynamics(true_mass, -true_mass * total, (rate_slow, rate_fast))


def without_bias_massless(viscous_n_s_per_m: float, spring_n_per_m: float, period_s: float) -> float | None:
    """Undo the bias of F_v^ fitted without a mass: F_v^ s + k = 0, F_v = -k/l; None where there is none."""
    if not viscous_n_s_per_m > 0.0:
        return None
    if spring_n_per_m == 0.0:
        return viscous_n_s_per_m
    return -spring_n_per_m / _rate(complex(-spring_n_per_m / viscous_n_s_per_m), period_s).real


def _rate(difference_rate: complex, period_s: float) -> complex:
    return -cmath.log(1.0 - difference_rate * period_s) / period_s
