"""What the instants of a polled test's writes and looks leave unknown of its positions, by the simulated motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import certified
from estimators.likelihood.delay import DELAY
from estimators.likelihood.descent import descend
from estimators.likelihood.inputs.commanded_path import CommandedPath
from estimators.likelihood.inputs.row_timing import PositionDoubts, look_doubts_s, shared_by_rest
from estimators.likelihood.model import Corners, StemModel
from estimators.likelihood.problem import Problem
from estimators.likelihood.row_weights import weight_of
from estimators.likelihood.search import Found
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray, Samples
from valve.recording import Recording

# Own choices. So many times all writes are put anywhere within their exchanges, by a generator of its own.
_DRAWS: Final = 32
_SEED: Final = 20070
_LATER_S: Final = 5.0e-5
_AT_REST: Final = 1.0e-3  # of the noise, from one row to the next
_ROUNDS: Final = 5
_MOVED: Final = 1.0  # of the cost: a round that gains less changes nothing
_DESCENT_STEPS: Final = 12
_PLACES: Final = 3
_MOST_TRIALS: Final = 300
_FEWEST_TRIED: Final = 2
_HOP_ROUNDS: Final = 2
_GAINED: Final = 4.0
_USUAL_MASS_KG: Final = 2.0
_STATIC_SHARES: Final = (-0.012, -0.006, -0.003, 0.0, 0.003, 0.006, 0.012)
_VISCOUS_FACTORS: Final = (0.5, 0.7, 1.0)
_WIDER: Final = 2.0  # rows of one tread are not independent
_FLOORS: Final = (0.3, 0.05, 0.01, 0.0)  # of a tread
_FAR: Final = 3.0  # standard deviations
_ROBUST_ROUNDS: Final = 2
_ROBUST_STEPS: Final = 6


def reweighted(found: Found, path: CommandedPath, motion: RecordedMotion, problem: Problem) -> Found:
    """Return the fit with each row weighted by what its own motion makes of the doubt in its writes and its look.

    What the simulated positions scatter by where all writes fall anywhere in their exchanges holds also what no
    derivative tells: that a stem breaks away at this write or at the next, or that a write still meets it in motion.
    The search had no motion to take that from, so places are followed anew, by weights that let go of rows far off:
    first as if all positions were as rough as a part of a tread, at last as they are.
    """
    if motion.recording is None:
        return found
    doubted = _Doubted(found.model, path, motion.recording, motion.samples, problem.noise_m)
    tread_m = _tread_m(motion.samples.position_m)
    tried: list[_Weighed] = []
    for start in [found.point, *_rough_starts(found, problem, tread_m), *(place.point for place in found.others)]:
        tried += doubted.followed(start, [share * tread_m for share in _FLOORS])
        if tried and tried[-1].is_good and len(tried) >= _FEWEST_TRIED:
            break
    if not tried:
        return found
    for _ in range(_HOP_ROUNDS):
        best = min(tried, key=_rank)
        if best.is_good and sum(one.unlikeliness < best.unlikeliness + _GAINED for one in tried) >= _FEWEST_TRIED:
            break
        near = [doubted.weighed(point) for point in _hops(best, motion.moving_mass_kg)]
        likely = sorted((one for one in near if one is not None), key=lambda one: one.unlikeliness)
        for one in likely[:_PLACES]:
            tried += doubted.followed(one.point, [share * tread_m for share in _FLOORS[1:]])
        now = min(tried, key=_rank)
        if now.is_good == best.is_good and now.unlikeliness > best.unlikeliness - _GAINED:
            break
    best = min(tried, key=_rank)
    ended = descend(best.model, best.point, most_steps=_DESCENT_STEPS)
    certificate = certified(best.model, ended.point)
    return replace(
        found,
        model=replace(best.model, weight=best.model.weight / _WIDER),
        point=ended.point,
        cost=ended.cost / _WIDER**2,
        certificate=certificate,
        # another place has other weights: their costs on these tell nothing
        others=(),
        noise_factor=1.0,
        simulations=found.simulations + (len(tried) + 1) * len(_FLOORS) * _DRAWS,
    )


def _rough_starts(found: Found, problem: Problem, tread_m: float) -> list[FloatArray]:
    """The trials, (p,) each, that come nearest to a recording as rough as a part of a tread."""
    rough = np.where(found.model.weight > 0.0, 1.0 / (_FLOORS[0] * tread_m), 0.0)
    model = replace(found.model, weight=rough)
    held = found.model.coordinates.values(found.point)
    every = max(1, len(problem.trials) // _MOST_TRIALS)
    points = [model.coordinates.point({**held, **trial.values}) for trial in problem.trials[::every]]
    points.sort(key=lambda point: _unlikeliness(model, point))
    return points[:_PLACES]


def _hops(best: _Weighed, mass_kg: float | None) -> list[FloatArray]:
    """Points (p,) apart in what a staircase hardly tells: the mass, the delay with F_v, the tread of breakaway."""
    values = best.model.coordinates.values(best.point)
    points = []
    for mass in {mass_kg or _USUAL_MASS_KG, values["m"]}:
        for share in _STATIC_SHARES:
            changed = values | {"m": mass, "d": max((1.0 + values["d"]) * (1.0 + share) - 1.0, 0.0)}
            if mass != values["m"]:
                # a delay t is much like k t of damping, and so is a part of what a mass does
                viscous = values["F_v"] + values["k"] * values.get(DELAY, 0.0)
                viscous = max(viscous, 0.1 * values["F_v"])
                points += [{**changed, DELAY: 0.0, "F_v": factor * viscous} for factor in _VISCOUS_FACTORS]
            else:
                points.append(changed)
    return [best.model.coordinates.point(changed) for changed in points]


def _rank(one: _Weighed) -> tuple[bool, float]:
    """What explains the recording goes before what is likelier by its tails."""
    return not one.is_good, one.unlikeliness


def _settled(doubted: _Doubted, first: _Weighed) -> _Weighed:
    """Descend and weigh anew until it changes nothing more; the likeliest on the way."""
    best, now = first, first
    for _ in range(_ROUNDS):
        # the weights move more than the differences' sides: the last descent takes both
        lower = descend(now.model, now.point, most_steps=_DESCENT_STEPS, one_sided=True)
        again = doubted.weighed(lower.point)
        if again is None:
            break
        gain, now = now.unlikeliness - again.unlikeliness, again
        best = min(best, again, key=_rank)
        if abs(gain) < _MOVED:
            break
    return best


def _tread_m(position_m: FloatArray) -> float:
    """How far the stem goes within a tread of a ramp, m: the median of the larger half of the changes."""
    change_m = np.sort(np.abs(np.diff(position_m)))
    return float(change_m[(3 * change_m.size) // 4])


def _counted_once(model: StemModel, doubts: PositionDoubts, still: BoolArray, noise_m: float) -> float:
    """What the logarithms of a rest's weights count too much: its rows have the noise each, and one error together."""
    total_m = np.hypot(noise_m, doubts.total_m)
    share = shared_by_rest(still, total_m, doubts.lasting_m)
    rests = still & (doubts.lasting_m > 0.0) & (model.weight > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rests, [False]]).astype(np.int8)))
    together = sum(
        math.log1p((end - first) * float(np.mean(doubts.lasting_m[first:end] ** 2)) / noise_m**2)
        for first, end in zip(edges[0::2], edges[1::2], strict=True)
    )
    return together - 2.0 * float(np.log(total_m[rests] / share[rests] / noise_m).sum())


def _unlikeliness(model: StemModel, point: FloatArray) -> float:
    """Twice the negative log likelihood, but for a constant, of errors with a heavy tail."""
    residual = model.residuals(point)
    if residual is None:
        return math.inf
    measured = model.weight > 0.0
    far = _FAR**2 * np.log1p((residual[measured] / _FAR) ** 2)
    return float(far.sum() - 2.0 * np.log(model.weight[measured]).sum()) + model.prior_cost(point)


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """A model with the weights of this point (p,), and how unlikely the recording is with both."""

    model: StemModel
    point: FloatArray
    unlikeliness: float

    @property
    def is_good(self) -> bool:
        """Whether noise and the doubts explain the recording."""
        return certified(self.model, self.point).is_good


@dataclass(frozen=True, slots=True, eq=False)
class _Doubted:
    """What weighs the rows of a model by the doubts that a point's own motion gives them."""

    model: StemModel
    path: CommandedPath
    recording: Recording
    samples: Samples
    noise_m: float

    def weighed(self, point: FloatArray, floor_m: float = 0.0) -> _Weighed | None:
        """Weigh the rows at ``point`` (p,), all positions rougher by ``floor_m``; None where there is no motion."""
        doubts = position_doubts_at(self.model, point, self.path, self.recording)
        if doubts is None:
            return None
        total, still = doubts
        noise_m = math.hypot(self.noise_m, floor_m)
        weight = weight_of(self.samples, noise_m, total, still)
        model = replace(self.model, weight=np.where(self.model.weight > 0.0, weight, 0.0))
        return _Weighed(model, point, _unlikeliness(model, point) + _counted_once(self.model, total, still, noise_m))

    def followed(self, point: FloatArray, floors_m: list[float]) -> list[_Weighed]:
        """Return where a start (p,) leads to over these floors and then on, alone in a list; empty where it is lost."""
        for floor_m in floors_m:
            lower = self.descended(point, floor_m)
            if lower is None:
                return []
            point = lower
        weighed = self.weighed(point)
        return [] if weighed is None else [_settled(self, weighed)]

    def descended(self, point: FloatArray, floor_m: float) -> FloatArray | None:
        """Return where weights that let go of rows far off lead to from ``point`` (p,), found anew twice."""
        weighed = self.weighed(point, floor_m)
        for _ in range(_ROBUST_ROUNDS):
            residual = None if weighed is None else weighed.model.residuals(point)
            if weighed is None or residual is None:
                return None
            loose = weighed.model.weight / np.sqrt(1.0 + (residual / _FAR) ** 2)
            model = replace(weighed.model, weight=loose)
            point = descend(model, point, most_steps=_ROBUST_STEPS, one_sided=True).point
        return point


def position_doubts_at(
    model: StemModel, point: FloatArray, path: CommandedPath, recording: Recording
) -> tuple[PositionDoubts, BoolArray] | None:
    """Return the doubts of the positions at a fit and the rows at rest, (n,); None where it cannot be followed."""
    delay_s = model.coordinates.values(point).get(DELAY, 0.0)

    def simulated(changed: CommandedPath, later_s: float = 0.0) -> FloatArray | None:
        return replace(model, path=_At(changed, delay_s + later_s)).simulate(point)

    here, after, before = simulated(path), simulated(path, _LATER_S), simulated(path, -_LATER_S)
    if here is None or after is None or before is None:
        return None
    doubt_s = look_doubts_s(recording, np.searchsorted(recording.time_s, model.time_s))
    look_m = (after - before) / (2.0 * _LATER_S) * doubt_s
    square, drawn = np.zeros(here.size), 0
    random = np.random.default_rng(_SEED)
    reach_s = np.sqrt(3.0) * path.write_doubt_s
    for _ in range(_DRAWS):
        moved = simulated(path.rewritten(reach_s * random.uniform(-1.0, 1.0, reach_s.size)))
        if moved is not None:
            square += (moved - here) ** 2
            drawn += 1
    if drawn < _DRAWS // 2:
        return None
    written_m = np.sqrt(square / drawn)
    change = np.abs(np.diff(here)) * float(model.weight.max())
    rests = np.concatenate([change <= _AT_REST, [False]]) & np.concatenate([[False], change <= _AT_REST])
    return PositionDoubts(np.hypot(look_m, written_m), np.where(rests, written_m, 0.0)), rests


class _At:
    """A path at a given delay, whatever the nuisances."""

    def __init__(self, path: CommandedPath, delay_s: float) -> None:
        self._corners = path.corners(np.array([delay_s]))

    def corners(self, _values: FloatArray) -> Corners:
        return self._corners
