"""The force balance of a drive without a spring, low-pass filtered alike on both sides: no noise is differentiated.

With a window w (sum 1, zero phase) every sample gives one row of

    w * F = m (w * a) + F_v (w * v) + F_c (w * sgn v) + F_0 + error,

where w * a = w'' * x: the derivatives fall on the window. This is the inverse dynamic identification of robots
(Janot, Gautier & Brunot 2019) with a window of finite length in the place of a Butterworth filter run forward and
backward, so that a row depends on nothing beyond its window. With D2 the second and D0 the central difference,
D2 x / T^2 is the acceleration's mean under a triangle two periods wide. That mean is (1 + D2/6) F of a force that is
straight between its samples, (1 - D2/12) D0 x / T of the velocity and (1 + D2/24) of a period's mean of sgn v, to T^4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft

from estimators.samples import BoolArray, FloatArray

ComplexArray = npt.NDArray[np.complex128]

COLUMNS: Final = ("m", "F_v", "F_c", "F_0")
_NEIGHBOURS: Final = 41  # own choice, of simulated axes


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Kernels for force, sense of motion, velocity (m to m/s) and acceleration (m to m/s2), shape (2 * reach + 1,)."""

    half_width: int
    force: FloatArray
    between: FloatArray  # the part of the kernel for force that says how the force goes between its samples
    sense: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @property
    def reach(self) -> int:
        """Rows on each side that a filtered row depends on."""
        return self.half_width + 2


def window(half_width: int, period_s: float) -> Window:
    """Return the kernels of w = cos^4 over ``half_width`` rows on each side; its gain is 1/2 at about 0.5 / length."""
    reach = half_width + 2
    rows = np.arange(-reach, reach + 1)
    shape = np.where(np.abs(rows) <= half_width, np.cos(0.5 * np.pi * rows / (half_width + 1)) ** 4, 0.0)
    shape /= shape.sum()
    second = np.convolve(shape, (1.0, -2.0, 1.0), mode="same")
    central = np.convolve(shape, (0.5, 0.0, -0.5), mode="same")
    return Window(
        half_width=half_width,
        force=shape + second / 6.0,
        between=second / 6.0,
        sense=shape + second / 24.0,
        velocity=(central - np.convolve(central, (1.0, -2.0, 1.0), mode="same") / 12.0) / period_s,
        acceleration=second / period_s**2,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Transforms of position less its start, force and sense of motion; ``length`` holds any window of ``reach``."""

    count: int
    length: int
    position: ComplexArray
    force: ComplexArray
    sense: ComplexArray

    def with_sense(self, sense: FloatArray) -> Spectra:
        """Return the same channels with another sense of motion, shape (n,), dimensionless."""
        return replace(self, sense=rfft(sense, self.length))

    def rows(self, used: Window) -> tuple[FloatArray, FloatArray]:
        """Filtered regressors in the order of COLUMNS, shape (n, 4), and force, shape (n,); wrong at the ends."""
        regressors = np.ones((len(COLUMNS), self.count)).T  # each column lies together in memory
        regressors[:, 0] = self.filtered(self.position, used.acceleration)
        regressors[:, 1] = self.filtered(self.position, used.velocity)
        regressors[:, 2] = self.filtered(self.sense, used.sense)
        return regressors, self.filtered(self.force, used.force)

    def filtered(self, transformed: ComplexArray, kernel: FloatArray) -> FloatArray:
        """Convolve a transformed channel with a kernel about its middle, shape (n,).

        ``transformed``: shape (length // 2 + 1,), ``kernel``: shape (k,), in any units.
        """
        half = kernel.size // 2
        whole = irfft(transformed * rfft(kernel, self.length), self.length)
        return np.asarray(whole[half : half + self.count])

    def gain(self, kernel: FloatArray) -> FloatArray:
        """Squared gain of a kernel at each frequency: the spectrum of white noise of variance 1 behind it.

        ``kernel``: shape (k,); the gain has its unit squared.
        """
        return np.asarray(np.abs(rfft(kernel, self.length)) ** 2)

    def smooth_spectrum(self, residual: FloatArray, rows: BoolArray) -> FloatArray:
        """Spectrum of a residual that is 0 off ``rows``: its periodogram, averaged over _NEIGHBOURS frequencies.

        ``residual``, N, and ``rows``: shape (n,).
        """
        power = np.abs(rfft(residual, self.length)) ** 2 / np.count_nonzero(rows)
        half = max(1, round(0.5 * _NEIGHBOURS * self.length / self.count))
        mirrored = np.concatenate([power[half:0:-1], power, power[-2 : -half - 2 : -1]])
        sums = np.concatenate([[0.0], np.cumsum(mirrored)])
        mean = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
        # the coefficients are as slow as the lowest frequencies, and took their number of them
        return np.asarray(mean * _NEIGHBOURS / (_NEIGHBOURS - len(COLUMNS)))

    def variance(self, weights: FloatArray, density: FloatArray) -> FloatArray:
        """Variance, shape (p,), of the sum of each row of ``weights``, shape (p, n), times a noise of this spectrum.

        ``density``: shape (length // 2 + 1,), in the noise's unit squared.
        """
        transformed = rfft(weights, self.length)
        power = transformed.real**2 + transformed.imag**2
        both_sides = np.full(density.size, 2.0)
        both_sides[0] = 1.0
        if self.length % 2 == 0:
            both_sides[-1] = 1.0
        return np.asarray(power @ (both_sides * density) / self.length)


def spectra(position_m: FloatArray, force_n: FloatArray, sense: FloatArray, reach: int) -> Spectra:
    """Return the transforms of evenly sampled channels, shape (n,), for windows of up to ``reach`` rows a side.

    ``sense`` is dimensionless: -1, 0 or 1.
    """
    count = position_m.size
    length = next_fast_len(count + 2 * reach + 1, real=True)
    moved = rfft(position_m - position_m[0], length)
    return Spectra(count, length, moved, rfft(force_n, length), rfft(sense, length))
