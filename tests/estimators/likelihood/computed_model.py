"""A model whose positions are a formula of the unknowns, for tests of what walks on a cost."""

from __future__ import annotations

import numpy as np

from estimators.likelihood.model import STEP, StemModel
from estimators.samples import FloatArray


class ComputedModel(StemModel):
    """``simulate_each`` is the formula; the derivatives are differences of it."""

    def slopes(
        self,
        point: FloatArray,
        free: list[int] | None = None,
        steps: FloatArray | None = None,
        *,
        one_sided: bool = False,
        here: FloatArray | None = None,
    ) -> FloatArray | None:
        """Derivatives of the weighted positions to the coordinates, shape (p, n), by central differences."""
        del one_sided, here
        sizes = np.full(point.size, STEP) if steps is None else steps
        ways = np.diag(
            np.where(np.isin(np.arange(point.size), np.arange(point.size) if free is None else free), sizes, 0)
        )
        above, below = self.simulate_each(point + ways)[0], self.simulate_each(point - ways)[0]
        slopes: FloatArray = 0.5 * (above - below) / sizes[:, None] * self.weight
        return slopes
