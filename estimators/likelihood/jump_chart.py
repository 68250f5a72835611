"""Unknowns in which what jumps show is straight: F_s and the jump's length in the place of F_c and F_s/F_c."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.jump_lengths import beyond_balance
from estimators.samples import FloatArray, IntArray

_STEP: Final = 1.0e-6  # of differences
_LEAST_COULOMB: Final = 1.0e-6  # of F_s: less is no friction in motion


@dataclass(frozen=True, slots=True, eq=False)
class JumpChart:
    """Charted points (p,): as the coordinates', with ln F_s in the place of ln F_c and ln L in that of F_s/F_c - 1.

    L = (1 + exp(-pi z/sqrt(1 - z^2))) (F_s - F_c)/k, z = F_v/(2 sqrt(k m)), is how far a free stem jumps. The recorded
    levels show L and F_s to a small part of the noise; m, F_v and F_c that keep both lie on a curve, which is a
    straight line here, so that a step along it does not leave the valley of the cost.
    """

    coordinates: Coordinates
    _place: IntArray = field(init=False)  # of m, k, F_v, F_c and d

    def __post_init__(self) -> None:
        names = self.coordinates.names
        object.__setattr__(self, "_place", np.array([names.index(name) for name in ("m", "k", "F_v", "F_c", "d")]))

    def charted(self, point: FloatArray) -> FloatArray | None:
        """Return the charted point, shape (p,), of this one; None where F_s is no more than F_c, without any jump."""
        mass, spring, viscous, coulomb, ratio = self._place
        if not point[ratio] > 0.0:
            return None
        own = point.copy()
        own[coulomb] = point[coulomb] + math.log1p(point[ratio])
        stiction = point[coulomb] + math.log(point[ratio])
        own[ratio] = stiction - point[spring] + math.log1p(self._beyond(point[mass], point[spring], point[viscous]))
        return own

    def point(self, own: FloatArray) -> FloatArray | None:
        """Return the point, shape (p,), of this charted one; None where its jump leaves no friction in motion."""
        mass, spring, viscous, coulomb, ratio = self._place
        beyond = self._beyond(own[mass], own[spring], own[viscous])
        share = math.exp(own[ratio] + own[spring] - own[coulomb]) / (1.0 + beyond)
        if share > 1.0 - _LEAST_COULOMB:
            return None
        point = own.copy()
        point[coulomb] = own[coulomb] + math.log1p(-share)
        point[ratio] = share / (1.0 - share)
        return np.clip(point, self.coordinates.lower, self.coordinates.upper)

    def slopes(self, own: FloatArray) -> FloatArray | None:
        """Change of the point's unknowns (columns) with each charted one (rows), shape (p, p)."""
        slopes = np.eye(own.size)
        for number in self._place:
            sides = []
            for step in (-_STEP, _STEP):
                beside = own.copy()
                beside[number] += step
                sides.append(self.point(beside))
            below, above = sides
            if below is None or above is None:
                return None
            slopes[number] = (above - below) / (2.0 * _STEP)
        return slopes

    @staticmethod
    def _beyond(log_mass: float, log_spring: float, log_viscous: float) -> float:
        return beyond_balance(0.5 * math.exp(log_viscous - 0.5 * (log_mass + log_spring)))
