"""The fit of the filtered force balance, freed of the position's noise, with errors true to slow residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import NORMAL_95, student_95
from estimators.drive.equation import COLUMNS, Spectra, Window
from estimators.samples import BoolArray, FloatArray, Samples

_WAVES: Final = 24  # own choice: correlation up to a 12th of the recording is seen; on simulated axes
_WIDENING: Final = student_95(_WAVES) / NORMAL_95  # few waves: Student's t in the place of the normal
_BLOCKS: Final = 2000
_RIDGE: Final = 1.0e-12  # of the scaled normal matrix: what is not determined gets an interval without end
_NOISE_KNOWN: Final = 0.1  # share to which the attenuation by position noise is known
_FEWEST_ROWS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class ForceFit:
    """Coefficients (m, F_v, F_c, F_0), shape (4,), and what was fitted.

    ``noise_share`` is the part of the filtered acceleration's mean square that is noise; ``attenuation``, (4,), is what
    the noise would take from the coefficients if it were not taken out.
    """

    coefficients: FloatArray
    bread: FloatArray  # inverse of the normal matrix, (4, 4)
    attenuation: FloatArray
    noise_share: float
    window: Window
    rows: BoolArray
    regressors: FloatArray
    residual_n: FloatArray
    residual_rms_n: float

    @property
    def count(self) -> int:
        """Number of rows fitted."""
        return int(np.count_nonzero(self.rows))


def usable_rows(samples: Samples, unsure: BoolArray, reach: int) -> BoolArray:
    """Rows, shape (n,), whose window lies in one run and touches no row of ``unsure``."""
    index = np.arange(samples.count)
    whole = (index - reach >= samples.run_first) & (index + reach <= samples.run_last)
    before = np.concatenate([[0], np.cumsum(unsure)])
    low, high = np.maximum(index - reach, 0), np.minimum(index + reach + 1, samples.count)
    return np.asarray(whole & (before[high] == before[low]))


def fit_force(samples: Samples, channels: Spectra, unsure: BoolArray, used: Window) -> ForceFit | None:
    """Least squares of the filtered force; the noise's share of the normal matrix is taken out of it.

    X'X grows by n sigma^2 (|k_a|^2, |k_v|^2) through white noise sigma of the position (errors in variables).
    None where too few rows are left. ``unsure``: shape (n,).
    """
    rows = usable_rows(samples, unsure, used.reach)
    count = int(np.count_nonzero(rows))
    if count < _FEWEST_ROWS:
        return None
    regressors, force_n = channels.rows(used)
    regressors *= rows[:, None]
    force_n *= rows
    normal = regressors.T @ regressors
    noise = np.zeros_like(normal)
    for place, kernel in enumerate((used.acceleration, used.velocity)):
        noise[place, place] = count * samples.position_noise_m**2 * float(kernel @ kernel)
    scale = np.sqrt(np.diag(normal))
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return None
    unit = np.outer(scale, scale)
    values, vectors = np.linalg.eigh((normal - noise) / unit)
    bread = (vectors / np.maximum(values, _RIDGE)) @ vectors.T / unit
    coefficients = bread @ (regressors.T @ force_n)
    residual = force_n - regressors @ coefficients
    # one step of refinement makes good what the normal equations lose
    coefficients = coefficients + bread @ (regressors.T @ residual + noise @ coefficients)
    residual = force_n - regressors @ coefficients
    rms = float(np.sqrt(residual @ residual / (count - len(COLUMNS))))
    share = float(noise[0, 0] / normal[0, 0])
    return ForceFit(coefficients, bread, bread @ noise @ coefficients, share, used, rows, regressors, residual, rms)


def force_error_n(fit: ForceFit, noise_m: float) -> float:
    """Error of one sample of the force, N: what the position's noise leaves of the residual, taken as white."""
    from_position = noise_m * float(np.linalg.norm(_position_kernel(fit.coefficients, fit.window)))
    rest = fit.residual_rms_n**2 - from_position**2
    least = 0.05 * fit.residual_rms_n
    return math.sqrt(max(rest, least**2)) / float(np.linalg.norm(fit.window.force))


def _position_kernel(coefficients: FloatArray, used: Window) -> FloatArray:
    return np.asarray(coefficients[0] * used.acceleration + coefficients[1] * used.velocity)


def white_errors(
    fit: ForceFit, channels: Spectra, coefficients: FloatArray, noise_m: float, force_n: float
) -> FloatArray:
    """Standard errors, shape (4,), that white noise of position and force (one sample's, ``force_n``) makes.

    A row's error is k_F * e - (m k_a + F_v k_v) * n; that of the coefficients is sum_j e_j (k_F' X B)_j, and so on.
    """
    density = force_n**2 * channels.gain(fit.window.force)
    density += noise_m**2 * channels.gain(_position_kernel(coefficients, fit.window))
    return _with_noise_bias(fit, channels.variance(fit.bread @ fit.regressors.T, density))


def correlated_errors(fit: ForceFit, channels: Spectra) -> FloatArray:
    """Standard errors, shape (4,), of a residual that is as the found one everywhere: by its smoothed spectrum."""
    density = channels.smooth_spectrum(fit.residual_n, fit.rows)
    return _with_noise_bias(fit, channels.variance(fit.bread @ fit.regressors.T, density))


def _with_noise_bias(fit: ForceFit, variance: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(variance + (_NOISE_KNOWN * fit.attenuation) ** 2))


def influences(fit: ForceFit) -> FloatArray:
    """What each row's residual adds to the coefficients, shape (n, 4)."""
    scores = fit.regressors * fit.residual_n[:, None]
    scores -= fit.rows[:, None] * (scores.sum(axis=0) / fit.count)  # the noise's part, so that they sum to 0
    return np.asarray(scores @ fit.bread)


def slow_covariance(fit: ForceFit) -> FloatArray:
    """Covariance of the coefficients, (4, 4), that holds whatever the residual's correlation, for normal intervals."""
    uncertain = _NOISE_KNOWN * fit.attenuation
    return by_waves(influences(fit)) + np.outer(uncertain, uncertain)


def by_waves(influence: FloatArray) -> FloatArray:
    """Covariance (p, p) of the sum of what each row adds to p coefficients, shape (n, p), in SI.

    The outer products of its first cosine coefficients (Lazarus, Lewis, Stock & Watson 2018), widened to what
    Student's t asks for. The fit, as slow as the waves are, has taken as many of them as it has coefficients.
    """
    starts = np.linspace(0, influence.shape[0], min(_BLOCKS, influence.shape[0]) + 1).astype(np.int64)[:-1]
    blocks = np.add.reduceat(influence, starts, axis=0)
    phase = (np.arange(blocks.shape[0]) + 0.5) / blocks.shape[0]
    parts = np.cos(np.pi * np.outer(np.arange(1, _WAVES + 1), phase)) @ blocks
    return np.asarray(2.0 / (_WAVES - len(COLUMNS)) * _WIDENING**2 * parts.T @ parts)


def sampling_errors(fit: ForceFit, channels: Spectra) -> FloatArray:
    """Standard errors, shape (4,), for what the force did between its samples: straight, or anything as smooth.

    The change of the coefficients if the force were taken at its samples alone, as the half-width of an even spread.
    """
    change = channels.filtered(channels.force, fit.window.between) * fit.rows
    return np.asarray(np.abs(fit.bread @ (fit.regressors.T @ change)) / math.sqrt(3.0))


@dataclass(frozen=True, slots=True)
class SpringCheck:
    """Spring rate that the residual would have, N/m, its standard error, and the share of the residual that it takes.

    The position counts only as far as the other regressors do not follow it: on a sine it is the acceleration.
    """

    spring_n_per_m: float
    std_error: float
    share: float


def spring_that_shows(fit: ForceFit, channels: Spectra) -> SpringCheck:
    """Return what a spring would add to the fit."""
    position_m = channels.filtered(channels.position, fit.window.force) * fit.rows
    own = position_m - fit.regressors @ (fit.bread @ (fit.regressors.T @ position_m))
    size, misfit = float(own @ own), float(fit.residual_n @ fit.residual_n)
    if not (size > 0.0 and misfit > 0.0):
        return SpringCheck(0.0, math.inf, 0.0)
    spring = float(own @ fit.residual_n) / size
    influence = own * (fit.residual_n - spring * own) / size
    error = math.sqrt(float(by_waves(influence[:, None])[0, 0]))
    return SpringCheck(spring, error, spring**2 * size / misfit)
