"""What the instants of a polled test's writes and looks leave unknown of its positions, by the simulated motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.commanded_path import CommandedPath
from estimators.likelihood.delay import DELAY
from estimators.likelihood.descent import descend
from estimators.likelihood.model import Corners, StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.row_timing import look_doubts_s
from estimators.likelihood.search import Found, certified
from estimators.samples import FloatArray
from valve.recording import Recording

# Own choices. A write moves the positions until the next few; so many groups are tried apart from each other.
_GROUPS: Final = 8
_LATER_S: Final = 5.0e-5
_AT_REST: Final = 1.0e-3  # standard deviations from one row to the next
_BEFORE_A_REST: Final = 3  # writes that may have brought the stem to where it rests
_DESCENT_STEPS: Final = 12


def reweighted(found: Found, path: CommandedPath, recording: Recording, noise_m: float) -> Found:
    """Return the fit with each row weighted by what its own motion makes of the doubt in its writes and its look.

    Variance of row i, at the fit: noise^2 + (dx_i/dt look doubt)^2 + the sum over the writes of (dx_i/dw_j doubt_j)^2.
    """
    error_m = _errors_m(found.model, found.point, path, recording, noise_m)
    if error_m is None:
        return found
    measured = np.where(found.model.weight > 0.0, 1.0, 0.0)
    model = replace(found.model, weight=measured / error_m)
    starts = [found.point, *(place.point for place in found.others)]
    ended = [descend(model, start, most_steps=_DESCENT_STEPS) for start in starts]
    best, *others = sorted((Place(one.point, one.cost) for one in ended), key=lambda place: place.cost)
    return replace(
        found,
        model=model,
        point=best.point,
        cost=best.cost,
        certificate=certified(model, best.point),
        others=tuple(others),
        noise_factor=1.0,
        simulations=found.simulations + sum(one.simulations for one in ended) + 2 * _GROUPS + 3,
    )


def _errors_m(
    model: StemModel, point: FloatArray, path: CommandedPath, recording: Recording, noise_m: float
) -> FloatArray | None:
    """One standard deviation of each row's position, m, shape (n,); None where the motion cannot be followed."""
    values = model.coordinates.values(point)
    delay_s = values.get(DELAY, 0.0)

    def simulated(changed: CommandedPath, later_s: float = 0.0) -> FloatArray | None:
        return replace(model, path=_At(changed, delay_s + later_s)).simulate(point)

    here, after, before = simulated(path), simulated(path, _LATER_S), simulated(path, -_LATER_S)
    if here is None or after is None or before is None:
        return None
    doubt_s = look_doubts_s(recording, np.searchsorted(recording.time_s, model.time_s))
    square = noise_m**2 + ((after - before) / (2.0 * _LATER_S) * doubt_s) ** 2
    group = np.arange(path.step_s.size) % _GROUPS
    for number in range(_GROUPS):
        late_s = np.where(group == number, path.write_doubt_s, 0.0)
        for moved in (simulated(path.rewritten(late_s)), simulated(path.rewritten(-late_s))):
            if moved is None:
                return None
            square += 0.5 * (moved - here) ** 2
    return np.asarray(np.sqrt(square))


def doubtful_writes(model: StemModel, point: FloatArray, path: CommandedPath) -> Iterator[Corners]:
    """Corners with one write later by its doubt, for each that may decide when the stem leaves a rest or where it ends.

    Such an error stays for a whole slip or rest; that of any other write is over with its tread.
    """
    simulated_m = model.simulate(point)
    if simulated_m is None or not path.is_stepped:
        return
    rests = np.abs(np.diff(simulated_m)) * model.weight[1:] <= _AT_REST
    turns = np.flatnonzero(rests[1:] != rests[:-1]) + 1
    delay_s = model.coordinates.values(point).get(DELAY, 0.0) + path.fit.dead_time_s + path.fit.lag_s
    wanted: set[int] = set()
    for row in turns:
        # the write in force at the row after the turn, and those before it
        last = int(np.searchsorted(path.step_s, model.time_s[row + 1] - delay_s, side="right")) - 1
        wanted |= set(range(max(last - _BEFORE_A_REST, 0), last + 1))
    for number in sorted(wanted):
        late_s = np.zeros(path.step_s.size)
        late_s[number] = path.write_doubt_s[number]
        yield path.rewritten(late_s).corners(np.array([model.coordinates.values(point).get(DELAY, 0.0)]))


class _At:
    """A path at a given delay, whatever the nuisances."""

    def __init__(self, path: CommandedPath, delay_s: float) -> None:
        self._corners = path.corners(np.array([delay_s]))

    def corners(self, _values: FloatArray) -> Corners:
        return self._corners
