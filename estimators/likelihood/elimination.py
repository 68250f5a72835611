"""The errors of a measured input eliminated from a fit that has them as unknowns: a search is one of the valve's again.

About a point with the errors e_1 the residuals are r - D (e - e_1), and e has unit variance: with the measured position
moved by D e_1 that is r' - D e, whose lowest cost over e is r'^T (I + D D^T)^{-1} r'. It holds as far from the point as
D does, however large e_1 is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.descent import Descent, descend
from estimators.likelihood.model import Corners, ForcePath, StemModel
from estimators.samples import FloatArray

FEW_ERRORS: Final = 6  # that are followed as they are
_ROUNDS: Final = 3
_SETTLED: Final = 0.1  # of the cost
_KEPT_PROMISE: Final = 0.5  # of the gain: less, and the errors are not as linear as they look
_SEEN: Final = 0.03  # standard deviations by which one sigma moves all rows together


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """``model`` has the valve's unknowns (p,) alone, and ``spread`` (n, d') the errors' share of the covariance.

    ``effect``, shape (n, d), is what each error does to its rows.
    """

    model: StemModel
    effect: FloatArray
    spread: FloatArray

    @property
    def count(self) -> int:
        """How many unknowns are left."""
        return len(self.model.coordinates.entries)

    def with_errors(self, point: FloatArray) -> FloatArray:
        """Return the point (p + d,) with the errors that go best with this one (p,), which can be followed."""
        position_m = self.model.simulate(point)
        if position_m is None:
            raise RuntimeError("a valve that was followed cannot be followed any more")
        left = (self.model.position_m - position_m) * self.model.weight
        normal = self.effect.T @ self.effect + np.eye(self.effect.shape[1])
        return np.concatenate([point, np.linalg.solve(normal, self.effect.T @ left)])


def spread_of(effect: FloatArray) -> FloatArray:
    """Return B, shape (n, d), of errors with this ``effect`` D, shape (n, d'): (I + D D^T)^{-1/2} = I - B B^T.

    With D V = U S it is U sqrt(1 - 1/sqrt(1 + S^2)); what all rows together do not show, S < 0.03, is left out.
    """
    squares, directions = np.linalg.eigh(effect.T @ effect)
    is_seen = squares > _SEEN**2
    squares, seen = squares[is_seen], effect @ directions[:, is_seen]
    return np.asarray(seen * np.sqrt((1.0 - 1.0 / np.sqrt(1.0 + squares)) / squares))


def eliminated(widened: StemModel, point: FloatArray, *, one_sided: bool = False) -> Eliminated | None:
    """Return the model, whose last unknowns are its deviations' shares, without these: about ``point`` (p + d,).

    None where the stem cannot be followed there. ``one_sided`` differences cost half as much.
    """
    count = point.size - len(widened.deviations)
    shares = list(range(count, point.size))
    slopes = widened.slopes(point, shares, one_sided=one_sided)
    if slopes is None:
        return None
    effect, errors, weight = slopes[count:].T, point[count:], widened.weight
    moved_m = np.divide(effect @ errors, weight, out=np.zeros_like(weight), where=weight > 0.0)
    spread = spread_of(effect)
    model = replace(
        widened,
        path=_Bent(widened.path, widened.deviations, errors),
        deviations=(),
        coordinates=Coordinates(widened.coordinates.entries[:count]),
        position_m=widened.position_m + moved_m,
        spread=spread,
    )
    return Eliminated(model, effect, spread)


def descend_with_errors(
    model: StemModel,
    start: FloatArray,
    *,
    most_steps: int,
    rounds: int = _ROUNDS,
    one_sided: bool = False,
    most_simulations: float = math.inf,
) -> Descent:
    """Return where a descent from ``start`` (p + d,) ends; many errors are eliminated linearly, and found, in rounds.

    A hundred of them take a hundred simulations a step, and a step hardly changes what they do.
    """
    if len(model.deviations) <= FEW_ERRORS:
        return descend(model, start, most_steps=most_steps, one_sided=one_sided, most_simulations=most_simulations)
    best, simulations = Descent(start, model.cost(start), 1, False), 1
    for _ in range(rounds):
        left = most_simulations - simulations
        near = eliminated(model, best.point, one_sided=True) if math.isfinite(best.cost) and left > 0.0 else None
        if near is None:
            break
        found = descend(
            near.model, best.point[: near.count], most_steps=most_steps, one_sided=one_sided, most_simulations=left
        )
        simulations += len(model.deviations) + found.simulations + 3
        point = near.with_errors(found.point)
        cost = model.cost(point)
        gain, promised = best.cost - cost, best.cost - found.cost
        if gain > 0.0:
            best = Descent(point, cost, simulations, found.arrived)
        if promised < _SETTLED:
            return replace(best, simulations=simulations, arrived=True)
        if gain < _KEPT_PROMISE * promised:
            break
    else:
        return replace(best, simulations=simulations)
    # what the errors do changes on the way: all go step by step
    left = most_simulations - simulations
    found = descend(model, best.point, most_steps=most_steps, one_sided=one_sided, most_simulations=left)
    return replace(found, simulations=found.simulations + simulations)


class _Bent:
    """A force's corners with its errors as they were found, whatever its nuisances."""

    def __init__(self, path: ForcePath, deviations: tuple[Corners, ...], errors: FloatArray) -> None:
        self._path = path
        self._late_s = sum((share * late_s for share, (late_s, _) in zip(errors, deviations, strict=True)), np.zeros(1))
        self._more_n = sum((share * more_n for share, (_, more_n) in zip(errors, deviations, strict=True)), np.zeros(1))

    def corners(self, values: FloatArray) -> Corners:
        time_s, force_n = self._path.corners(values)
        return np.maximum.accumulate(time_s + self._late_s), force_n + self._more_n
