"""From the recording to the lowest point of the cost: grid, descent with restarts at rests, descent without."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.certificate import Certificate, certify
from estimators.likelihood.descent import Descent, descend
from estimators.likelihood.model import Restarts, StemModel
from estimators.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

# Own choices: how many grid points are followed, and for how long.
_FOLLOWED: Final = 4
_EXACT: Final = 0.1  # of the noise: only without noise, and then nothing can be better
_RESTARTED_STEPS: Final = 12
_STEPS: Final = 40
_SCANNED: Final = 41
_SCAN: Final = 0.05
_MOVING_AT_FIRST: Final = ("m", "k", "F_v", "F_c", "d", "F_0")
_LEAST_REST_ROWS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best point (p,), its cost and certificate, and how many starts and simulations it took."""

    point: FloatArray
    cost: float
    certificate: Certificate
    starts: int
    simulations: int
    arrived: bool


def measured_rests(motion: RecordedMotion) -> Restarts:
    """Return where the measured stem rests between motions."""
    stretches = motion.phases.stretches
    row, position_m = [], []
    for before, after in pairwise(stretches):
        first, last = before.last + 1, after.first - 1
        if last - first + 1 < _LEAST_REST_ROWS:
            continue
        row.append((first + last) // 2)
        position_m.append(float(np.mean(motion.samples.position_m[first : last + 1])))
    return Restarts(np.array(row, dtype=np.int64), np.array(position_m, dtype=np.float64))


def search(model: StemModel, trials: list[dict[str, float]], rests: Restarts) -> Found | None:
    """Return the lowest point reached from these trial values; None where nothing moves.

    The best trial of each class of DV is followed, for a large DV may look like a large F_v at a higher cost; more
    trials only where none explains the recording.
    """
    restarted = replace(model, restarts=rests)
    points = [model.coordinates.point(trial) for trial in trials]
    costs = np.array([restarted.cost(point) for point in points])
    order = [int(number) for number in np.argsort(costs) if np.isfinite(costs[number])]
    classes = {trials[number]["DV"]: number for number in reversed(order)}
    firsts = sorted(classes.values(), key=lambda number: costs[number])
    others = [number for number in order if number not in firsts]
    simulations, starts, best = len(points), 0, None
    for number in [*firsts, *others[:_FOLLOWED]]:
        if best is not None and best.certificate.is_good and number not in firsts:
            break
        found = _follow(model, restarted, points[number])
        starts, simulations = starts + 1, simulations + found.simulations
        if best is None or found.cost < best.cost:
            certificate = _certified(model, found.point)
            best = Found(found.point, found.cost, certificate, starts, simulations, found.arrived)
        if best.certificate.ratio < _EXACT:
            break
    return None if best is None else replace(best, starts=starts, simulations=simulations)


def _follow(model: StemModel, restarted: StemModel, point: FloatArray) -> Descent:
    held = tuple(name for name in model.coordinates.names if name not in _MOVING_AT_FIRST)
    first = descend(restarted, point, most_steps=_RESTARTED_STEPS, held=held)
    scanned, tried = _scan(model, first.point)
    second = descend(model, scanned, most_steps=_STEPS)
    return replace(second, simulations=first.simulations + tried + second.simulations)


def _scan(model: StemModel, point: FloatArray) -> tuple[FloatArray, int]:
    """Scan F_s about the point on the cost of the position: one minimum in it, while the velocity's has several."""
    place = model.coordinates.names.index("d")
    ratio = 1.0 + point[place]
    best, least = point, model.cost(point)
    for share in np.linspace(-_SCAN, _SCAN, _SCANNED):
        trial = point.copy()
        trial[place] = max(0.0, ratio * (1.0 + share) - 1.0)
        cost = model.cost(trial)
        if cost < least:
            best, least = trial, cost
    return best, _SCANNED + 1


def _certified(model: StemModel, point: FloatArray) -> Certificate:
    residual = model.residuals(point)
    if residual is None:
        return Certificate(float("inf"), float("inf"), 0)
    return certify(residual, model.weight)
