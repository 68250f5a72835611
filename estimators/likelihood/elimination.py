"""The errors of a measured input eliminated from a fit that has them as unknowns: a search is one of the valve's again.

About a point with the errors e_1 the residuals are r - D (e - e_1), and e has unit variance: with the measured position
moved by D e_1 that is r' - D e, whose lowest cost over e is r'^T (I + D D^T)^{-1} r'. It holds as far from the point as
D does, however large e_1 is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.model import Corners, ForcePath, StemModel
from estimators.samples import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """``model`` has the valve's unknowns (p,) alone; ``effect``, shape (n, d), is what each error does to its rows."""

    model: StemModel
    effect: FloatArray

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


def eliminated(widened: StemModel, point: FloatArray) -> Eliminated | None:
    """Return the model, whose last unknowns are its deviations' shares, without these: about ``point`` (p + d,).

    None where the stem cannot be followed there.
    """
    count = point.size - len(widened.deviations)
    shares = list(range(count, point.size))
    slopes = widened.slopes(point, shares)
    if slopes is None:
        return None
    effect, errors, weight = slopes[count:].T, point[count:], widened.weight
    directions, sizes, _ = np.linalg.svd(effect, full_matrices=False)
    moved_m = np.divide(effect @ errors, weight, out=np.zeros_like(weight), where=weight > 0.0)
    model = replace(
        widened,
        path=_Bent(widened.path, widened.deviations, errors),
        deviations=(),
        coordinates=Coordinates(widened.coordinates.entries[:count]),
        position_m=widened.position_m + moved_m,
        spread=directions * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + sizes * sizes)),
    )
    return Eliminated(model, effect)


class _Bent:
    """A force's corners with its errors as they were found, whatever its nuisances."""

    def __init__(self, path: ForcePath, deviations: tuple[Corners, ...], errors: FloatArray) -> None:
        self._path = path
        self._late_s = sum((share * late_s for share, (late_s, _) in zip(errors, deviations, strict=True)), np.zeros(1))
        self._more_n = sum((share * more_n for share, (_, more_n) in zip(errors, deviations, strict=True)), np.zeros(1))

    def corners(self, values: FloatArray) -> Corners:
        time_s, force_n = self._path.corners(values)
        return np.maximum.accumulate(time_s + self._late_s), force_n + self._more_n
