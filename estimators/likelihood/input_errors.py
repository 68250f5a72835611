"""The errors of the measured input as unknowns of the fit: the position tells of the force's lines too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.certificate import certify
from estimators.likelihood.coordinates import Coordinates, linear
from estimators.likelihood.descent import descend
from estimators.likelihood.model import Corners, StemModel
from estimators.likelihood.search import Found
from estimators.samples import FloatArray

PREFIX: Final = "input_"
# Own choices: directions whose one sigma moves all positions together by less do not matter; the most that are fitted.
_LEAST_EFFECT: Final = 0.05
_MOST: Final = 40
_STEP_SHARE: Final = 0.05  # of the range, within one period: steeper than any ramp
_STEPS: Final = 12


def with_input_errors(model: StemModel, point: FloatArray, changed: Iterable[Corners]) -> StemModel:
    """Return the model with an unknown input_1, ... of standard deviation 1 for each direction that matters.

    ``changed`` are corners changed by one sigma along each independent direction, at the nuisances of ``point`` (p,).
    """
    time_s, force_n = model.corners(model.coordinates.values(point))
    here = model.simulate(point)
    if here is None:
        return model
    sized: list[tuple[float, Corners]] = []
    for other_s, other_n in changed:
        if other_s.shape != time_s.shape:
            continue
        step = (other_s - time_s, other_n - force_n)
        moved = replace(model, path=_Moved((other_s, other_n))).simulate(point)
        effect = float("inf") if moved is None else float(np.linalg.norm((moved - here) * model.weight))
        if effect > _LEAST_EFFECT:
            sized.append((effect, step))
    sized.sort(key=lambda pair: -pair[0])
    deviations = tuple(step for _, step in sized[:_MOST])
    more = [linear(f"{PREFIX}{number}", 1.0, sd=1.0) for number in range(1, len(deviations) + 1)]
    return replace(model, deviations=deviations, coordinates=Coordinates((*model.coordinates.entries, *more)))


def step_instants(corners: Corners, period_s: float) -> Iterator[Corners]:
    """Corners with each step of the force later by a period / sqrt(12): it lies anywhere between two samples."""
    time_s, force_n = corners
    least_n = _STEP_SHARE * float(np.ptp(force_n))
    is_step = (np.diff(time_s) <= 1.01 * period_s) & (np.abs(np.diff(force_n)) > least_n)
    for first in np.flatnonzero(is_step)[:_MOST]:
        moved_s = time_s.copy()
        moved_s[first : first + 2] += period_s / np.sqrt(12.0)
        yield moved_s, force_n


def refit(model: StemModel, found: Found) -> Found:
    """Descend again with the input's errors as unknowns, from a fit without them."""
    start = np.concatenate([found.point, np.zeros(len(model.deviations))])
    again = descend(model, start, most_steps=_STEPS)
    residual = model.residuals(again.point)
    if residual is None:
        return replace(found, point=start)
    return replace(
        found,
        point=again.point,
        cost=again.cost,
        certificate=certify(residual, model.weight),
        simulations=found.simulations + again.simulations,
        arrived=again.arrived,
    )


class _Moved:
    """Corners as they are given, whatever the nuisances."""

    def __init__(self, corners: Corners) -> None:
        self._corners = corners

    def corners(self, _values: FloatArray) -> Corners:
        return self._corners
