"""What a valve may do beyond the engine's model: laws with parameters of their own, which a fit takes in beside m, k.

A law may add to the friction, to the force on the stem and to the force at which a rest breaks away. All of it is
neutral by default: a law says only what it changes. Forces are functions of where, when and how the stem moves, each
instant by itself; a fit evaluates them along the path of its last step, at all instants at once.
"""

# ruff: noqa: ARG002 - a law is neutral by default, whatever it is asked
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Where:
    """Coordinates of a law's forces at instants, arrays of shape (n,).

    ``speed_m_per_s`` and ``direction`` have the sign of the motion. ``force_n`` is the actuator's and ``rate_n_per_s``
    its change. ``rested_s`` is how long the rest before the move was, ``before`` the direction of the move before that,
    0 if unknown.
    """

    time_s: FloatArray
    travel_m: FloatArray
    speed_m_per_s: FloatArray
    force_n: FloatArray
    rate_n_per_s: FloatArray
    direction: FloatArray
    rested_s: FloatArray
    before: FloatArray

    @property
    def count(self) -> int:
        """Number of instants."""
        return int(self.time_s.size)


@dataclass(frozen=True, slots=True)
class LawParameter:
    """One parameter of a law: its unit, natural range, what is known beforehand (mean and standard deviation).

    ``step`` is how far it is varied to see how the motion answers, ``start`` its value where nothing is known yet.
    """

    name: str
    unit: str
    low: float
    high: float
    mean: float
    spread: float
    start: float
    step: float

    @property
    def longest_step(self) -> float:
        """How far one step of a fit may lead."""
        return 0.25 * (self.high - self.low)


class Law:
    """A law without any effect: what is overridden is what it changes. ``values`` are those of ``parameters``."""

    parameters: tuple[LawParameter, ...] = ()

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what adds to the friction of a moving stem, N, against the motion; ``values``: shape (p,), SI."""
        return np.zeros(where.count)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what adds to the actuator's force, N, above 0 towards larger positions; at rests too.

        ``values``: shape (p,), SI.
        """
        return np.zeros(where.count)

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return what adds to F_s at rests that break away; ``share`` is F_s over F_c; ``values``: shape (p,), SI."""
        return share * self.friction_n(values, where)


@dataclass(frozen=True, slots=True, eq=False)
class PathToFit:
    """A law of the force's path, and other starts of it, each with the stem's lag that goes with it, s.

    ``lag_at`` is the place of the path's lag, as a logarithm, among the law's values; None where it has none.
    """

    law: Law
    others: tuple[tuple[FloatArray, float], ...]
    lag_at: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Laws:
    """Several laws, whose parameters follow one another in one vector, shape (p,)."""

    laws: tuple[Law, ...] = ()

    @property
    def parameters(self) -> tuple[LawParameter, ...]:
        """All parameters in their order."""
        return tuple(parameter for law in self.laws for parameter in law.parameters)

    @property
    def count(self) -> int:
        """Number of parameters."""
        return sum(len(law.parameters) for law in self.laws)

    def _with_values(self, values: FloatArray) -> Sequence[tuple[Law, FloatArray]]:
        ends = np.cumsum([len(law.parameters) for law in self.laws])[:-1]
        return list(zip(self.laws, np.split(values, ends), strict=True)) if self.laws else []

    def driving_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what all laws add to the force that drives a moving stem, N; ``values``: shape (p,), SI."""
        total = np.zeros(where.count)
        for law, own in self._with_values(values):
            total += law.force_n(own, where) - where.direction * law.friction_n(own, where)
        return total

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return by how much more force, N, in their direction, rests break away; ``values``: shape (p,), SI."""
        total = np.zeros(where.count)
        for law, own in self._with_values(values):
            total += law.breakaway_n(own, where, share) - where.direction * law.force_n(own, where)
        return total

    @property
    def low(self) -> FloatArray:
        """Lower ends of the natural ranges."""
        return np.array([one.low for one in self.parameters])

    @property
    def high(self) -> FloatArray:
        """Upper ends of the natural ranges."""
        return np.array([one.high for one in self.parameters])

    @property
    def mean(self) -> FloatArray:
        """Means beforehand."""
        return np.array([one.mean for one in self.parameters])

    @property
    def spread(self) -> FloatArray:
        """Standard deviations beforehand."""
        return np.array([one.spread for one in self.parameters])

    @property
    def start(self) -> FloatArray:
        """Values where nothing is known yet."""
        return np.array([one.start for one in self.parameters])

    @property
    def longest_step(self) -> FloatArray:
        """How far one step of a fit may lead."""
        return np.array([one.longest_step for one in self.parameters])


NO_LAWS = Laws()
