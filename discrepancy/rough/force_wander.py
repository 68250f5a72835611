"""A force that wanders in time alike in both directions, as no friction does: a spring, or the zero of a reading."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from discrepancy.rough.evidence import Solved, solved
from valve.messages import Message, say

FloatArray = npt.NDArray[np.float64]

_TIMES_S: Final = (2.0, 4.0, 8.0, 16.0, 32.0)
_SHARES: Final = np.geomspace(0.002, 0.1, 12)  # of the full force: standard deviations of the wander
_KNOTS: Final = 3.0  # in one of its times
_SURE: Final = 12.0  # nats: a name needs as many; what a reading that lags leaves in the balance shows up to 8


def wanders_alike(null: Solved, model: Solved, full_force_n: float) -> Message | None:
    """Return what wanders where that alone explains the recording better than the causes in ``model`` do, else None.

    The wander is a Gaussian process in time (Matern 3/2) that adds to the actuator's force whatever the direction. It
    is compared by the marginal likelihood, with the hyperparameters of the plain fit and with those of usual packings:
    friction that varies may have taken it up.
    """
    usual = solved(null.problem, null.columns, null.problem.medians)
    worth, size_n = max(
        (model.cost - plain.cost + gain, size_n)
        for plain in (null, usual)
        for gain, size_n in _gains(plain, full_force_n)
    )
    if worth < _SURE:
        return None
    return say(
        "force_wanders",
        "The balance of forces wanders by {size:.2g N} in time, alike in both directions, and friction does not. "
        "Check the zeros of position and pressure and how the transmitter is fixed, and repeat the test.",
        size=size_n,
    )


def _gains(plain: Solved, full_force_n: float) -> list[tuple[float, float]]:
    """For each time the most nats that a wander is worth, and its standard deviation, N."""
    time_s, found = plain.problem.rows.time_s, []
    sizes_n2 = (_SHARES * full_force_n) ** 2
    for lasts_s in _TIMES_S:
        basis = _basis(time_s, lasts_s)
        information = basis.T @ plain.projection @ basis
        answers, turned = eigh(0.5 * (information + information.T))
        pulls = (turned.T @ (basis.T @ plain.weighted)) ** 2
        answers = np.maximum(answers, 0.0)
        gains = [
            0.5 * float(np.sum(size_n2 * pulls / (1.0 + size_n2 * answers) - np.log1p(size_n2 * answers)))
            for size_n2 in sizes_n2
        ]
        best = int(np.argmax(gains))
        found.append((gains[best], math.sqrt(float(sizes_n2[best]))))
    return found


def _basis(time_s: FloatArray, lasts_s: float) -> FloatArray:
    """Columns, shape (n, at most n), whose sum with independent standard normal sizes is the process.

    It is straight between knots. Where these were more than rows, as of recordings of several days, the rows are them.
    """
    first_s, last_s = float(time_s.min()), float(time_s.max())
    count = max(2, math.ceil((last_s - first_s) / lasts_s * _KNOTS) + 1)
    if count >= time_s.size:
        return _root(time_s, lasts_s)
    root = _root(np.linspace(first_s, last_s, count), lasts_s)
    place = (time_s - first_s) / max(last_s - first_s, 1.0e-9) * (count - 1)
    below = np.clip(np.floor(place).astype(np.int64), 0, count - 2)
    part = (place - below)[:, None]
    return np.asarray((1.0 - part) * root[below] + part * root[below + 1])


def _root(at_s: FloatArray, lasts_s: float) -> FloatArray:
    """A root of the process' covariance at these times, shape (n, n)."""
    away = math.sqrt(3.0) * np.abs(at_s[:, None] - at_s[None, :]) / lasts_s
    return np.asarray(np.linalg.cholesky((1.0 + away) * np.exp(-away) + 1.0e-9 * np.eye(at_s.size)))
