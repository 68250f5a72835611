"""Unknowns in which what jumps show is straight: the breakaway's force and the jump's length, not F_c and F_s/F_c."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.jump_kernel import breakaway, jump_excess, jump_length
from estimators.samples import FloatArray, IntArray

CHARTED: Final = ("m", "k", "F_v", "F_c", "d", "DV")
_STEP: Final = 1.0e-6  # of differences
_LEAST_COULOMB: Final = 1.0e-6  # of the breakaway's force: less is no friction in motion


@dataclass(frozen=True, slots=True, eq=False)
class JumpChart:
    """Charted points (p,): as the coordinates', with ln F_b in the place of ln F_c and ln L in that of F_s/F_c - 1.

    On a ramp of ``rate_n_per_s`` the stem reaches DV under F_b, about F_s + sqrt(2 m DV rate), and jumps by L until it
    is as slow as DV again: both exact, from its motion. The recorded levels and instants show F_b and L to a small part
    of the noise; m, F_v, F_c and DV that keep both lie on a bent surface, which is a plane here, so that a step along
    it does not leave the valley of the cost.
    """

    coordinates: Coordinates
    rate_n_per_s: float
    _place: IntArray = field(init=False)  # of m, k, F_v, F_c, d and DV

    def __post_init__(self) -> None:
        names = self.coordinates.names
        place = np.array([names.index(name) for name in CHARTED])
        object.__setattr__(self, "_place", place)

    def charted(self, point: FloatArray) -> FloatArray | None:
        """Return the charted point, shape (p,), of this one; None where the stem does not jump at this rate."""
        *moving, coulomb, ratio, limit = self._place
        if not point[ratio] > 0.0:
            return None
        mass_kg, spring, viscous, limit_speed = np.exp(point[[*moving, limit]]).tolist()
        risen_n, before_m = breakaway(mass_kg, spring, limit_speed, self.rate_n_per_s)
        excess_n = math.exp(point[coulomb]) * point[ratio] + risen_n
        length_m = jump_length(mass_kg, spring, viscous, limit_speed, self.rate_n_per_s, before_m, excess_n)
        if math.isnan(length_m):
            return None
        own = point.copy()
        own[coulomb], own[ratio] = math.log(math.exp(point[coulomb]) + excess_n), math.log(length_m)
        return own

    def point(self, own: FloatArray) -> FloatArray | None:
        """Return the point, shape (p,), of this charted one; None where its jump leaves no friction in motion."""
        *moving, coulomb, ratio, limit = self._place
        mass_kg, spring, viscous, limit_speed, breakaway_n, length_m = np.exp(
            own[[*moving, limit, coulomb, ratio]]
        ).tolist()
        risen_n, before_m = breakaway(mass_kg, spring, limit_speed, self.rate_n_per_s)
        excess_n = jump_excess(mass_kg, spring, viscous, limit_speed, self.rate_n_per_s, before_m, length_m)
        coulomb_n = breakaway_n - excess_n
        if not (coulomb_n > _LEAST_COULOMB * breakaway_n and excess_n > risen_n):
            return None
        point = own.copy()
        point[coulomb], point[ratio] = math.log(coulomb_n), (excess_n - risen_n) / coulomb_n
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
