"""Of a command alone: dead time and friction in each other's place, as far as the cost lets them."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from estimators.identifiability.bound import Knowledge
from estimators.likelihood.bent_valley import usual_rate
from estimators.likelihood.inputs.transducer_path import DEAD_TIME
from estimators.likelihood.intervals import natural_values
from estimators.likelihood.mixture import reaching
from estimators.likelihood.model import StemModel
from estimators.samples import FloatArray

# Own choices.
_RISE: Final = 3.84  # of the cost: one value in twenty is as far off by chance
_FIRST_S: Final = 1.0e-3
_HALVINGS: Final = 8
_LEAST_COULOMB: Final = 0.02  # of the own


def about_middle_dead_time(knows: Knowledge, model: StemModel, point: FloatArray, noise_factor: float) -> Knowledge:
    """Return what is known about the middle of the dead times that cost less than 3.84 more, reaching both ends.

    On ramps of one rate r a dead time later by t is a friction smaller by r t: each breakaway comes at the same
    instant. Of a stem that jumps the cost does not change at all, up to where a jump more or less would come before a
    corner, so that the fit ends anywhere between. Without a dead time among the unknowns it is ``knows`` itself.
    """
    if DEAD_TIME not in model.coordinates.names:
        return knows
    highest = model.cost(point) + _RISE * noise_factor**2
    ends_s = [_farthest_s(model, point, sense, highest) for sense in (-1.0, 1.0)]
    here = natural_values(model, point)
    first, last = (natural_values(model, _exchanged(model, point, late_s)) for late_s in ends_s)
    moved = [0.5 * (first[symbol] + last[symbol]) - here[symbol] for symbol in knows.symbols]
    centred = replace(knows, values=tuple(value + more for value, more in zip(knows.values, moved, strict=True)))
    return reaching(centred, [first, last])


def _farthest_s(model: StemModel, point: FloatArray, sense: float, highest: float) -> float:
    values = model.coordinates.values(point)
    entry = next(entry for entry in model.coordinates.entries if entry.name == DEAD_TIME)
    bound_s = entry.unit * (entry.upper if sense > 0.0 else entry.lower)
    most_s = abs(bound_s - values[DEAD_TIME])
    rate = usual_rate(*model.corners(values))
    if sense > 0.0 and rate > 0.0:
        most_s = min(most_s, (1.0 - _LEAST_COULOMB) * values["F_c"] / rate)
    reached_s, beyond_s = 0.0, min(_FIRST_S, most_s)
    while model.cost(_exchanged(model, point, sense * beyond_s)) <= highest:
        reached_s = beyond_s
        if reached_s >= most_s:
            return sense * reached_s
        beyond_s = min(2.0 * beyond_s, most_s)
    for _ in range(_HALVINGS):
        half_s = 0.5 * (reached_s + beyond_s)
        if model.cost(_exchanged(model, point, sense * half_s)) <= highest:
            reached_s = half_s
        else:
            beyond_s = half_s
    return sense * reached_s


def acting_later(values: dict[str, float], late_s: float, rate_n_per_s: float) -> dict[str, float]:
    """Return the values by name with a dead time longer by ``late_s`` and friction less by what a ramp gains in it.

    Each breakaway on a ramp of this rate comes at the same instant. ``F_c`` is not above 0 where that takes all of it.
    """
    less_n = rate_n_per_s * late_s
    coulomb_n, static_n = values["F_c"] - less_n, values["F_c"] * (1.0 + values["d"]) - less_n
    ratio = static_n / coulomb_n - 1.0 if coulomb_n > 0.0 else values["d"]
    return values | {DEAD_TIME: values[DEAD_TIME] + late_s, "F_c": coulomb_n, "d": ratio}


def _exchanged(model: StemModel, point: FloatArray, late_s: float) -> FloatArray:
    values = model.coordinates.values(point)
    return model.coordinates.point(acting_later(values, late_s, usual_rate(*model.corners(values))))
