"""Figures that wander from test to test, fitted by generalised least squares under every law that the wander may have.

Nobody knows over how many days a valve's friction forgets where it was. So what is asked of the figures, a slope or a
change of level, is estimated under each law and averaged by the restricted likelihood (Harville 1977).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from valve.stem import FloatArray

_FARTHEST: Final = 3  # tests apart: friction wanders over some nights, a change that stays is in six of these pairs
_LEAST_TO_SCATTER: Final = 8  # so that those six are less than half of the pairs
OF_MEDIAN: Final = 1.4826  # standard deviation over median size, of a normal distribution
_EXACT: Final = 1.0e-9  # of the figure: nothing is measured better
# Days over which a wander is forgotten (0: at once), and the share of its variance that is new in each test.
_LAWS: Final = ((0.0, 1.0), (2.0, 0.1), (2.0, 0.5), (5.0, 0.1), (5.0, 0.5), (15.0, 0.1), (15.0, 0.5))


@dataclass(frozen=True, slots=True)
class Fit:
    """A constant and one regressor through several figures at the same tests; ``freedom`` is its degrees of freedom.

    ``constant`` and ``coefficient`` have shape (n_figures,), ``covariance`` theirs, shape (2, 2, n_figures).
    """

    constant: FloatArray
    coefficient: FloatArray
    covariance: FloatArray
    freedom: int


def scatter_between(values: Sequence[float]) -> float:
    """How much a figure differs from test to test, as a standard deviation in its unit; 0 for too few tests.

    1.4826 times the median size of the differences of tests up to three apart, over the root of 2. Neither a slow
    drift, nor a change that stays, nor a few odd tests are in it.
    """
    if len(values) < _LEAST_TO_SCATTER:
        return 0.0
    level = np.asarray(values, dtype=np.float64)
    apart = [np.abs(level[lag:] - level[:-lag]) for lag in range(1, _FARTHEST + 1)]
    return OF_MEDIAN * float(np.median(np.concatenate(apart))) / math.sqrt(2.0)


def fitted(days: FloatArray, regressor: FloatArray, values: FloatArray) -> Fit:
    """Return the fit of a constant and a regressor, shape (n,), to figures, shape (n, n_figures), in any units.

    ``days`` are those of the tests, shape (n,). A figure is what is fitted, what is new in each test, and a wander
    that is forgotten exponentially.
    """
    least = np.square(_EXACT * np.max(np.abs(values), axis=0))
    freedom = days.size - 2
    likelihoods, found, covariances = [], [], []
    for whitening, base, inverse, log_size in _factors(tuple(days.tolist()), tuple(regressor.tolist())):
        white = whitening @ values
        explained = base.T @ white
        rest = np.maximum(np.sum(np.square(white), axis=0) - np.sum(np.square(explained), axis=0), least)
        likelihoods.append(-log_size - 0.5 * freedom * np.log(np.maximum(rest, np.finfo(float).tiny)))
        found.append(inverse @ explained)
        covariances.append((inverse @ inverse.T)[:, :, None] * (rest / freedom))
    weights = np.exp(np.array(likelihoods) - np.max(likelihoods, axis=0))
    weights /= np.sum(weights, axis=0)
    mean = np.einsum("mf,mcf->cf", weights, np.array(found))
    apart = np.array(found) - mean
    spread = np.array(covariances) + apart[:, :, None] * apart[:, None, :]
    return Fit(mean[0], mean[1], np.einsum("mf,mcdf->cdf", weights, spread), freedom)


@lru_cache(maxsize=8)  # the figures of one result are of the same tests, but for a few
def _whitened(days: tuple[float, ...]) -> list[tuple[FloatArray, float]]:
    """Return for each law the inverse Cholesky factor of the tests' correlation, and half of its log determinant."""
    at = np.array(days)
    apart = np.abs(at[:, None] - at)
    laws = []
    for forgotten_days, share in _LAWS:
        correlation = share * np.eye(at.size)
        if forgotten_days > 0.0:
            correlation += (1.0 - share) * np.exp(-apart / forgotten_days)
        factor = np.linalg.cholesky(correlation)
        laws.append((np.linalg.inv(factor), float(np.sum(np.log(np.diag(factor))))))
    return laws


@lru_cache(maxsize=64)
def _factors(
    days: tuple[float, ...], regressor: tuple[float, ...]
) -> list[tuple[FloatArray, FloatArray, FloatArray, float]]:
    """Return for each law what whitens the tests, and the QR factors of what is fitted.

    That is: inverse Cholesky factor of the correlation, Q, inverse of R, and the logarithm of what scales the
    restricted likelihood.
    """
    design = np.column_stack((np.ones(len(days)), regressor))
    laws = []
    for whitening, log_size in _whitened(days):
        base, upper = np.linalg.qr(whitening @ design)
        log_all = log_size + float(np.sum(np.log(np.abs(np.diag(upper)))))
        laws.append((whitening, base, np.linalg.inv(upper), log_all))
    return laws
