"""Polynomials one after the other and how they meet: what a noisy channel's lines are given as."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from estimators.samples import FloatArray, IntArray

_NEWTON_ROUNDS: Final = 6
_SETTLED: Final = 1.0e-13  # of the time: the crossing of two lines after one round


class Joint(IntEnum):
    """How two pieces meet."""

    CORNER = 0  # same value, another slope: at their crossing
    SMOOTH = 1  # same value, same slope
    STEP = 2  # another value: between the last row of one and the first of the other


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Polynomials c0 + c1 u + c2 u^2 + c3 u^3, u = (t - centre)/half, one after the other; k pieces.

    ``centre_s``, ``half_s`` (k,), ``coefficient`` (k, 4), ``degree`` (k,), ``joint`` and ``joint_s`` (k - 1,).
    ``root`` (d, k, 4): the coefficients' changes by one sigma along d independent directions. ``rows`` (k,).
    """

    first_s: float
    last_s: float
    centre_s: FloatArray
    half_s: FloatArray
    coefficient: FloatArray
    degree: IntArray
    rows: IntArray
    joint: IntArray
    joint_s: FloatArray
    reach_s: FloatArray
    root: FloatArray

    def crossings(self, coefficient: FloatArray) -> FloatArray:
        """Times of the joints, shape (k - 1,), with these coefficients: corners move to where their pieces cross."""
        at_s = self.joint_s.copy()
        corner = self.joint == Joint.CORNER
        if not corner.any():
            return at_s
        left, right = np.flatnonzero(corner), np.flatnonzero(corner) + 1
        moving_s = at_s[corner]
        low_s, high_s = moving_s - self.reach_s[corner], moving_s + self.reach_s[corner]
        for _ in range(_NEWTON_ROUNDS):
            gap = self.values(coefficient, left, moving_s) - self.values(coefficient, right, moving_s)
            bend = self.slopes(coefficient, left, moving_s) - self.slopes(coefficient, right, moving_s)
            step_s = np.divide(gap, bend, out=np.zeros_like(gap), where=bend != 0.0)
            moving_s = np.clip(moving_s - step_s, low_s, high_s)
            if float(np.abs(step_s).max()) <= _SETTLED * float(np.abs(moving_s).max()):
                break
        at_s[corner] = moving_s
        return np.asarray(np.clip(np.maximum.accumulate(at_s), self.first_s, self.last_s))

    def values(self, coefficient: FloatArray, piece: IntArray, time_s: FloatArray) -> FloatArray:
        """Value of each ``piece`` at each time, shape (n,)."""
        u = (time_s - self.centre_s[piece]) / self.half_s[piece]
        c = coefficient[piece]
        return np.asarray(c[:, 0] + u * (c[:, 1] + u * (c[:, 2] + u * c[:, 3])))

    def slopes(self, coefficient: FloatArray, piece: IntArray, time_s: FloatArray) -> FloatArray:
        """Slope of each ``piece`` at each time, a second, shape (n,)."""
        u = (time_s - self.centre_s[piece]) / self.half_s[piece]
        c = coefficient[piece]
        return np.asarray((c[:, 1] + u * (2.0 * c[:, 2] + 3.0 * u * c[:, 3])) / self.half_s[piece])
