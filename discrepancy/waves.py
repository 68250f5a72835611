"""Sums of waves over instants at many frequencies: of tens of thousands, without a table of all of them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.samples import FloatArray

ComplexArray = npt.NDArray[np.complex128]

_AT_A_TIME: Final = 256  # frequencies: a table of a few megabytes at most


def wave_sums(frequency_hz: FloatArray, time_s: FloatArray, columns: FloatArray) -> ComplexArray:
    """Return the sums over n of exp(2 pi i f t) times each of the ``columns`` (n, c), shape (f, c).

    The frequencies, shape (f,), are a step apart each: exp(i (w0 + j dw) t) is a table of the j times one wave.
    """
    turn = 2.0 * math.pi * time_s
    table = np.exp(1.0j * np.outer(frequency_hz[:_AT_A_TIME] - frequency_hz[0], turn))
    sums = np.empty((frequency_hz.size, columns.shape[1]), np.complex128)
    for first in range(0, frequency_hz.size, _AT_A_TIME):
        count = min(_AT_A_TIME, frequency_hz.size - first)
        wave = np.exp(1.0j * frequency_hz[first] * turn)
        sums[first : first + count] = table[:count] @ (wave[:, None] * columns)
    return sums


def share_taken(frequency_hz: FloatArray, time_s: FloatArray, base: FloatArray, force_n: FloatArray) -> FloatArray:
    """Share of what the ``base`` (n, b) leaves of forces (n,) that a wave at each frequency takes, shape (f,).

    The frequencies are a step apart each.
    """
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    left = force_n - basis @ (basis.T @ force_n)
    sums = wave_sums(frequency_hz, time_s, np.column_stack([left, basis]))
    # exp(2 i w t): sin^2 = (1 - cos 2 w t)/2, and what of the waves lies in the base
    twice = wave_sums(2.0 * frequency_hz, time_s, np.ones((time_s.size, 1)))[:, 0]
    sine, cosine = sums[:, 1:].imag, sums[:, 1:].real
    ss = 0.5 * (time_s.size - twice.real) - np.sum(sine * sine, axis=1)
    cc = 0.5 * (time_s.size + twice.real) - np.sum(cosine * cosine, axis=1)
    sc = 0.5 * twice.imag - np.sum(sine * cosine, axis=1)
    s, c = sums[:, 0].imag, sums[:, 0].real
    determinant = ss * cc - sc * sc
    # a wave that is the base's own leaves rounding
    usable = (determinant > 1.0e-6 * ss * cc) & (np.minimum(ss, cc) > 1.0e-9 * time_s.size)
    won = np.where(usable, (cc * s * s - 2.0 * sc * s * c + ss * c * c) / np.where(usable, determinant, 1.0), 0.0)
    return np.asarray(won / max(float(left @ left), 1.0e-300))


def highest_of(frequency_hz: FloatArray, height: FloatArray, apart_hz: float, most: int) -> list[float]:
    """Return the frequencies of the highest, no two nearer than ``apart_hz``; none that has no height."""
    left = height.copy()
    found: list[float] = []
    while len(found) < most:
        place = int(np.argmax(left))
        if left[place] <= 0.0:
            break
        found.append(float(frequency_hz[place]))
        left[np.abs(frequency_hz - frequency_hz[place]) <= apart_hz] = 0.0
    return found
