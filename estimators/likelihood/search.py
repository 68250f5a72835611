"""From the recording to the lowest point of the cost: grid, descent with restarts at rests, descent without."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.certificate import Certificate, certify
from estimators.likelihood.descent import Descent, descend
from estimators.likelihood.model import Lead, Restarts, StemModel
from estimators.likelihood.start import Trial
from estimators.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

# Own choices: how many grid points are followed, and for how long.
_FOLLOWED: Final = 4
# Where none of these explains the recording: trials that are judged and followed with the measurement in the lead.
_LED_TRIED: Final = 32
_LED_FOLLOWED: Final = 3
# An overdamped stem's mass: tried again where the cost is nearly flat in it.
_OTHER_MASSES_KG: Final = (1.0, 10.0)
_FEW_EVENTS: Final = 600
_HOPELESS: Final = 1.5
_NEAR_MASS: Final = 1.0
_FAR_ABOVE: Final = 1.0e3
_LEADS: Final = (Lead(4, 0.4), Lead(4, 0.1), Lead(4, 0.02))
EXACT: Final = 0.1  # of the noise: only without noise, and then nothing can be better
_RESTARTED_STEPS: Final = 12
_STEPS: Final = 40
_SCAN: Final = np.concatenate([np.linspace(-0.05, 0.05, 41), np.linspace(-0.4, 0.8, 25)])  # of F_s
_RANKED_ROWS: Final = 3000  # that are simulated to rank the trials
_MOVING_AT_FIRST: Final = ("m", "k", "F_v", "F_c", "d", "F_0")
_STILL_SIGMAS: Final = 4.0
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
    is_explained: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "is_explained", self.is_explained or self.certificate.is_good)


def measured_rests(motion: RecordedMotion) -> Restarts:
    """Return where the measured stem surely rests between motions: its noise there is that of the sensor."""
    samples, stretches = motion.samples, motion.phases.stretches
    row, position_m = [], []
    for before, after in pairwise(stretches):
        first, last = before.last + 1, after.first - 1
        if last - first + 1 < _LEAST_REST_ROWS:
            continue
        own_m = samples.position_m[first : last + 1]
        half = own_m.size // 2
        drift_m = abs(float(own_m[half:].mean() - own_m[:half].mean()))
        limit_m = _STILL_SIGMAS * samples.position_noise_m + 1.0e-9 * float(np.ptp(samples.position_m))
        if drift_m <= limit_m * math.sqrt(2.0 / half) and float(np.ptp(own_m)) <= 2.5 * limit_m:
            row.append((first + last) // 2)
            position_m.append(float(own_m.mean()))
    return Restarts(np.array(row, dtype=np.int64), np.array(position_m, dtype=np.float64))


def search(
    model: StemModel, trials: list[Trial], rests: Restarts, explains: Callable[[Found], bool] | None = None
) -> Found | None:
    """Return the lowest point reached from these trial values; None where nothing moves.

    The best trial of each class of DV is followed, for a large DV may look like a large F_v at a higher cost; more
    trials only where none explains the recording, by its certificate or by ``explains``.
    """
    restarted = replace(model, restarts=rests)
    points = [model.coordinates.point(trial.values) for trial in trials]
    stride = 1 + model.time_s.size // _RANKED_ROWS
    costs = np.array([thinned(restarted, stride).cost(point) for point in points])
    order = _order(trials, costs)
    simulations, starts, best = len(points), 0, None
    for number, is_sure in order[:_FOLLOWED]:
        if best is not None and best.is_explained and not is_sure:
            break
        bar, most_events = math.inf, model.most_events
        if best is not None and best.is_explained:
            bar, most_events = best.cost, _FEW_EVENTS  # to beat what explains all already, a stem need not chatter
        quick = replace(model, most_events=most_events)
        found = _follow(quick, replace(quick, restarts=rests), points[number], bar)
        starts, simulations = starts + 1, simulations + found.simulations
        best = _better(model, best, found, explains)
        if best is not None and best.certificate.ratio < EXACT:
            break
    if best is None or not best.is_explained:
        led = replace(model, lead=_LEADS[0])
        tried = [number for number, _ in order[:_LED_TRIED]]
        tried.sort(key=lambda number: led.cost(points[number]))
        simulations += len(tried)
        for number in tried[:_LED_FOLLOWED]:
            found = _follow_led(model, points[number])
            starts, simulations = starts + 1, simulations + found.simulations
            best = _better(model, best, found, explains)
            if best is not None and best.is_explained:
                break
    if best is not None and best.certificate.ratio >= EXACT:
        for mass_kg in _OTHER_MASSES_KG:
            found = _with_mass(model, best.point, mass_kg)
            simulations += found.simulations
            best = _better(model, best, found, explains) or best
    return None if best is None else replace(best, starts=starts, simulations=simulations)


def _with_mass(model: StemModel, point: FloatArray, mass_kg: float) -> Descent:
    """Descend again from another mass: an overdamped stem hides it in the logarithm that it is fitted in."""
    place = model.coordinates.names.index("m")
    start = point.copy()
    start[place] = model.coordinates.entries[place].coordinate(mass_kg)
    if abs(start[place] - point[place]) < _NEAR_MASS or model.cost(start) > model.cost(point) + _FAR_ABOVE:
        return Descent(point, float("inf"), 2, False)
    return descend(model, start, most_steps=_STEPS // 3)


def _better(
    model: StemModel, best: Found | None, found: Descent, explains: Callable[[Found], bool] | None
) -> Found | None:
    if not math.isfinite(found.cost) or (best is not None and found.cost >= best.cost):
        return best
    better = Found(found.point, found.cost, _certified(model, found.point), 0, 0, found.arrived)
    if not better.is_explained and explains is not None:
        return replace(better, is_explained=explains(better))
    return better


def _order(trials: list[Trial], costs: FloatArray) -> list[tuple[int, bool]]:
    """Numbers of the trials in the order in which they are followed, and whether each is followed in any case."""
    ranked = [int(number) for number in np.argsort(costs) if np.isfinite(costs[number])]
    firsts: dict[float, int] = {}
    seconds: dict[tuple[float, ...], int] = {}
    for number in ranked:
        firsts.setdefault(trials[number].limit_share, number)
        seconds.setdefault((trials[number].limit_share, trials[number].static_share), number)
    sure = sorted(firsts.values(), key=lambda number: costs[number])
    others = [number for number in seconds.values() if number not in sure]
    rest = [number for number in ranked if number not in sure and number not in others]
    return [(number, True) for number in sure] + [(number, False) for number in others + rest]


def thinned(model: StemModel, stride: int) -> StemModel:
    """Return the model of every so many rows, for a quick look."""
    if stride < 2:
        return model
    restarts = model.restarts
    if restarts is not None:
        restarts = Restarts(-(-restarts.row // stride), restarts.position_m)
    return replace(
        model,
        time_s=np.ascontiguousarray(model.time_s[::stride]),
        position_m=model.position_m[::stride],
        weight=model.weight[::stride],
        section_row=-(-model.section_row // stride),
        restarts=restarts,
    )


def _follow(model: StemModel, restarted: StemModel, point: FloatArray, bar: float) -> Descent:
    """Descend with restarts, then without; not the second where the first is left far above ``bar``."""
    held = tuple(name for name in model.coordinates.names if name not in _MOVING_AT_FIRST)
    first = descend(restarted, point, most_steps=_RESTARTED_STEPS, held=held)
    if first.cost > _HOPELESS * bar + _FAR_ABOVE:
        return replace(first, cost=math.inf)
    scanned, tried = _scan(model, first.point)
    second = descend(model, scanned, most_steps=_STEPS)
    return replace(second, simulations=first.simulations + tried + second.simulations)


def _follow_led(model: StemModel, point: FloatArray) -> Descent:
    """Descend with the simulated stem led by the measured one, less and less."""
    held = tuple(name for name in model.coordinates.names if name not in _MOVING_AT_FIRST)
    simulations = 0
    for number, lead in enumerate(_LEADS):
        found = descend(replace(model, lead=lead), point, most_steps=_RESTARTED_STEPS, held=held if number == 0 else ())
        point, simulations = found.point, simulations + found.simulations
    last = descend(model, point, most_steps=_STEPS)
    return replace(last, simulations=simulations + last.simulations)


def _scan(model: StemModel, point: FloatArray) -> tuple[FloatArray, int]:
    """Scan F_s about the point on the cost of the position: one minimum in it, while the velocity's has several."""
    place = model.coordinates.names.index("d")
    ratio = 1.0 + point[place]
    best, least = point, model.cost(point)
    for share in _SCAN:
        trial = point.copy()
        trial[place] = max(0.0, ratio * (1.0 + share) - 1.0)
        cost = model.cost(trial)
        if cost < least:
            best, least = trial, cost
    return best, _SCAN.size + 1


def _certified(model: StemModel, point: FloatArray) -> Certificate:
    residual = model.residuals(point)
    if residual is None:
        return Certificate(float("inf"), float("inf"), 0)
    return certify(residual, model.weight)
