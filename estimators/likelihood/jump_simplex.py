"""A simplex in the unknowns that jumps show: it sees how the cost falls along their valley over its many small teeth.

Each of hundreds of jumps that comes to another row, or to another number of events, leaves a kink in the cost. A
descent by derivatives ends at the first of them, however far the cost falls beyond; the corners of a simplex (Nelder &
Mead 1965) lie many of them apart.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import minimize

from estimators.likelihood.bent_valley import chart_of
from estimators.likelihood.budget import Budget
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.samples import FloatArray

# Own choices, from random valves that stick and slip.
_FAR: Final = 0.05  # of a logarithm: edges of m, F_v and DV
_IN_ERRORS: Final = 3.0  # edges of all others, in standard deviations that they would have alone
_AN_UNKNOWN: Final = 160  # simulations
_MOST_UNKNOWNS: Final = 16
_ARRIVED: Final = 0.1  # of the cost
_OUT_OF_STEP: Final = 10.0  # mean square, in the noise's: jumps apart from the measured ones leave no valley to go down
_OUTSIDE: Final = 1.0e300
_VALLEY: Final = ("m", "F_v", "DV")


def down_by_simplex(model: StemModel, start: Place, budget: Budget, reserve: float) -> Place:
    """Return the lowest place that a simplex about ``start`` comes to; ``start`` where the stem does not jump there.

    As it is, too, where it is out of step with the measured one: lower is no nearer then.
    """
    chart = chart_of(model, start.point)
    own = chart.charted(start.point)
    count = start.point.size
    most = min(_AN_UNKNOWN * count, budget.most_simulations(model, 1.0) - int(reserve / budget.price(model, 1)))
    is_near = start.cost < _OUT_OF_STEP * model.weight.size
    if own is None or not is_near or count > _MOST_UNKNOWNS or most < count:
        return start
    slopes, along = model.slopes(start.point, one_sided=True), chart.slopes(own)
    if slopes is None or along is None:
        return start
    charted = along @ slopes
    size = np.sqrt(np.einsum("ij,ij->i", charted, charted))
    edges = np.minimum(np.divide(_IN_ERRORS, size, out=np.full(count, _FAR), where=size > 0.0), _FAR)
    for name in _VALLEY:
        edges[model.coordinates.names.index(name)] = _FAR

    def cost(trial: FloatArray) -> float:
        point = chart.point(trial)
        own_cost = math.inf if point is None else model.cost(point)
        return own_cost if math.isfinite(own_cost) else _OUTSIDE

    found = minimize(
        cost,
        own,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([own, own + np.diag(edges)]),
            "maxfev": most,
            "adaptive": True,
            "fatol": _ARRIVED,
            "xatol": math.inf,
        },
    )
    budget.spend(model, int(found.nfev) + count + 1)
    point = chart.point(found.x)
    return Place(point, float(found.fun)) if point is not None and found.fun < start.cost else start
