"""From the recording to the lowest places of the cost: many short descents on few rows, few on all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import MOST_PLACES, NEAR, exactly, on_all_rows
from estimators.likelihood.budget import Budget
from estimators.likelihood.certificate import Certificate, certify
from estimators.likelihood.compression import bent_rows, compressed, in_parts
from estimators.likelihood.hops import hops
from estimators.likelihood.model import Restarts, StemModel
from estimators.likelihood.pool import Place, chosen_trials, distinct, followed_from, halved, ranked
from estimators.likelihood.start import Trial
from estimators.likelihood.valley import led_down
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

# Own choices.
_HOP_STEPS: Final = ((30, 2), (8, 5), (3, 8))  # how many are followed, and for how many steps
_SCAN_STEPS: Final = 7
_LAST_SHARE: Final = 0.15  # of the budget
_SECOND_SHARE: Final = 0.6  # of the budget, more of it, for starts that are followed apart
_FIRST_STARTS: Final = 20  # which the first search follows
_AS_LOW: Final = 9.0  # of the cost, times the misfit's square
_RANKING_SHARE: Final = 0.2  # of the budget
_LED_OF_JUMPS: Final = 2  # places that are led down: the valley of jumps has sills
_REFILL: Final = 0.35  # of the budget, where what was found is not enough
_VALLEY_STEPS: Final = 30  # F_v, F_c and DV of jumps lie in a narrow valley
_HOP_ROUNDS: Final = 3
_BETTER: Final = 1.0  # of the cost: a hop that gains less is at the same place
_MORE_SEARCHES: Final = 2  # where the best does not explain the recording
_SURELY_LESS: Final = 0.8  # of the noise: it was overestimated
_SCAN: Final = np.concatenate([np.linspace(-0.05, 0.05, 21), np.linspace(-0.4, 0.8, 13)])  # of F_s
_USUAL: Final = 2  # models, where there are few rests
_SPACING: Final = 4
_EVENTS_A_BREAKAWAY: Final = 3
_MORE_EVENTS: Final = 10  # times the measured stem's: a trial valve that chatters
_FEW_EVENTS: Final = 40
_MOST_HIDDEN: Final = 12_000  # followed in 3 ms
_STILL_SIGMAS: Final = 4.0
_LEAST_REST_ROWS: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best point (p,), its cost and certificate, the model with its noise, and other places nearly as low.

    ``others`` are points (p,) and their costs on all rows, within 25 of the best.
    """

    model: StemModel
    point: FloatArray
    cost: float
    certificate: Certificate
    others: tuple[Place, ...]
    noise_factor: float  # on the noise that was believed at first
    starts: int
    simulations: int
    budget_left: float
    is_confirmed: bool = True  # of jumps: starts that were followed apart came to places as low as the best


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


@dataclass(frozen=True, slots=True)
class Hopping:
    """What a hop has to know: the usual sliding speed, and whether the stem jumps from rest to rest."""

    speed_m_per_s: float
    jumps: bool


def search(
    model: StemModel, trials: list[Trial], rests: Restarts, *, breakaways: int, hopping: Hopping
) -> Found | None:
    """Return the lowest place reached from these trial values and those nearly as low; None where nothing moves.

    On blocks of rows: the trials are ranked and followed with the stem started anew at each measured rest, the
    better of them without; then from the best to where the cost may be as low. On all rows: the few that are left.
    Of a stem that jumps other starts are followed apart, with the balance of forces of what was found: the classic
    methods have no values for it to start from, and its valley has sills.
    """
    model = with_events(model, breakaways)
    model.corners(trials[0].values)
    budget = Budget.of(model)
    limited = replace(model, most_events=min(model.most_events, _MORE_EVENTS * (model.events + _FEW_EVENTS)))
    small = compressed(limited)
    stages = _stages(limited, rests, jumps=hopping.jumps)
    whole = budget.left
    first = ranked(stages[0], chosen_trials(trials, budget.most_simulations(stages[0], _RANKING_SHARE)), budget)
    if not first:
        return None
    found = _Searching(small, stages, hopping)
    places = found.lowest(first, budget)
    apart: list[Place] = []
    if hopping.jumps:
        second = Budget.limited(_SECOND_SHARE * whole)
        starts = first[_FIRST_STARTS:]
        if places:
            near = [_with_its_balance(small, trial, places[0]) for trial in trials]
            starts = ranked(stages[0], chosen_trials(near, second.most_simulations(stages[0], _RANKING_SHARE)), second)
        apart = found.lowest(starts, second)[:1]
        budget.simulations += second.simulations
        budget.starts += second.starts
        alone, places = places[:1], distinct(small, [*places, *apart])
        apart = [*alone, *apart] if alone and apart else []
    if not places:
        return None
    factor = 1.0
    ended = on_all_rows(model, places, budget)
    if not ended:
        return None
    certificate = certified(model, ended[0].point)
    # rows of unequal weights leave less than their errors where these repeat: that is no noise taken too large
    is_even = float(np.ptp(model.weight[model.weight > 0.0])) == 0.0
    if is_even and exactly(model) < certificate.ratio < _SURELY_LESS:
        # the differences saw the motion as noise: what the best fit leaves is nearer to it
        factor = certificate.ratio
        model = replace(model, weight=model.weight / factor)
        small = compressed(replace(model, most_events=limited.most_events))
        budget.left = max(budget.left, _REFILL * whole)
        again = [Place(place.point, small.cost(place.point)) for place in places]
        ended = on_all_rows(model, _hopped(small, distinct(small, again), hopping, budget, whole), budget)
        certificate = certified(model, ended[0].point)
    for _ in range(_MORE_SEARCHES):
        if certificate.is_good or certificate.ratio < exactly(model):
            break
        budget.left = max(budget.left, _REFILL * whole)
        known = [Place(place.point, small.cost(place.point)) for place in [*ended, *places]]
        more = [_hopped(small, [place], hopping, budget, whole) for place in distinct(small, known)[:MOST_PLACES]]
        places = distinct(small, [place for some in more for place in some])
        ended = on_all_rows(model, places, budget) or ended
        certificate = certified(model, ended[0].point)
    others = tuple(place for place in ended[1:] if place.cost < ended[0].cost + NEAR)
    return Found(
        model,
        ended[0].point,
        ended[0].cost,
        certificate,
        others,
        factor,
        budget.starts,
        budget.simulations,
        budget.left / whole,
        not hopping.jumps or _are_as_low(small, ended[0], apart, certificate.ratio),
    )


def with_events(model: StemModel, breakaways: int) -> StemModel:
    """Return the model that follows so many breakaways, and the many more that a trial valve may have.

    Jumps that are smaller than the noise are not among the measured ones, so that the true valve may have ten times
    as many events; of thousands it may have twice as many.
    """
    events = _EVENTS_A_BREAKAWAY * breakaways
    hidden = min(_MORE_EVENTS * (events + _FEW_EVENTS), _MOST_HIDDEN)
    return replace(model, events=events, most_events=max(model.most_events, hidden, 2 * events))


def _with_its_balance(model: StemModel, trial: Trial, place: Place) -> Trial:
    """Return the trial with the spring, preload and F_s of this place, and all else that is no part of its valley.

    A place apart is one of other m, F_v, F_c/F_s and DV: a search that has to find the balance of forces too, from the
    worse of the guesses, may come to nothing and confirms nothing.
    """
    own = model.coordinates.values(place.point)
    coulomb_n = own["F_c"] * (1.0 + own["d"]) / (1.0 + trial.values["d"])
    tried = {name: trial.values[name] for name in ("m", "F_v", "d", "DV")}
    return replace(trial, values=own | tried | {"F_c": coulomb_n})


def _are_as_low(small: StemModel, best: Place, apart: list[Place], ratio: float) -> bool:
    """Whether each search of its own came to a place as low as the best, within what the noise leaves open."""
    rise = _AS_LOW * max(1.0, ratio**2)
    lowest = small.cost(best.point)
    return bool(apart) and all(small.cost(place.point) < lowest + rise for place in apart)


@dataclass(frozen=True, slots=True)
class _Searching:
    """The models of a search on blocks of rows: all starts go through them alike."""

    small: StemModel
    stages: list[StemModel]
    hopping: Hopping

    def lowest(self, first: list[Place], budget: Budget) -> list[Place]:
        """Follow these starts, and hop from the best; cheapest first."""
        small, stages, hopping, whole = self.small, self.stages, self.hopping, budget.whole
        # hops where a simulation is cheapest: many jumps need not be in step with the measured ones for that
        begins_anew = hopping.jumps and len(stages) > _USUAL
        begun = stages[:3] if begins_anew else [*stages, small]
        places = halved(begun, first, budget)
        if not begins_anew:
            places += [_with_scanned_friction(small, place, budget) for place in places[:2]]
        places = _hopped(begun[-1], distinct(small, places), hopping, budget, whole)
        if begins_anew:
            places = _hopped(small, halved([*stages[3:], small], places, budget), hopping, budget, whole)
        return places


def _stages(model: StemModel, rests: Restarts, *, jumps: bool) -> list[StemModel]:
    """Models begun anew at each rest, twice, and, where there are many, at fewer and fewer of them.

    Over many jumps the simulated stem falls out of step with the measured one unless it is nearly right already.
    """
    first = compressed(in_parts(model, rests, 1))
    stages, spacing = [first, first], _SPACING
    while jumps and spacing * _SPACING <= rests.row.size:
        stages.append(compressed(in_parts(model, rests, spacing)))
        spacing *= _SPACING
    return stages


def searched_again(small: StemModel, found: Found, hopping: Hopping) -> FloatArray:
    """Return the lowest point (p,) that hops from the best places lead to where other errors count in the cost."""
    budget = Budget.of(found.model)
    budget.left *= _REFILL
    starts = [found.point, *(place.point for place in found.others)]
    places = [followed_from(small, point, _SCAN_STEPS, budget) for point in starts]
    ended = _hopped(small, distinct(small, places), hopping, budget, budget.left)
    return ended[0].point if ended else found.point


def _hopped(small: StemModel, places: list[Place], hopping: Hopping, budget: Budget, whole: float) -> list[Place]:
    """Hop from the best place until none is lower, and return all that were found, cheapest first."""
    for _ in range(_HOP_ROUNDS):
        if not places or not budget.allows(_LAST_SHARE, whole):
            break
        best = places[0]
        found = [Place(point, 0.0) for point in hops(small, best.point, hopping.speed_m_per_s, jumps=hopping.jumps)]
        for kept, steps in _HOP_STEPS:
            found = distinct(small, _followed(small, found[:kept], steps, budget, fine=kept < 5))
        places = distinct(small, [*places, *found])
        lowest = [followed_from(small, place.point, _VALLEY_STEPS, budget, fine=True) for place in places[:2]]
        places = distinct(small, [*lowest, *places])
        if places[0].cost > best.cost - _BETTER:
            break
    if places:
        led = places[: _LED_OF_JUMPS if hopping.jumps else 1]
        places = distinct(small, [*(led_down(small, one, budget, _LAST_SHARE * whole) for one in led), *places])
    return places


def _followed(small: StemModel, places: list[Place], steps: int, budget: Budget, *, fine: bool) -> list[Place]:
    """Follow these places for so many steps, as many of them as the budget lets."""
    found: list[Place] = []
    for place in places:
        if budget.left < 0.0:
            break
        followed = followed_from(small, place.point, steps, budget, fine=fine)
        if math.isfinite(followed.cost):
            found.append(followed)
    return found


def _with_scanned_friction(model: StemModel, place: Place, budget: Budget) -> Place:
    """Scan F_s on the cost of the position, which has one minimum in it, and descend from there."""
    number = model.coordinates.names.index("d")
    ratio = 1.0 + place.point[number]
    best = place
    for share in _SCAN:
        trial = place.point.copy()
        trial[number] = max(0.0, ratio * (1.0 + share) - 1.0)
        cost = model.cost(trial)
        if cost < best.cost:
            best = Place(trial, cost)
    budget.spend(model, _SCAN.size)
    return place if best is place else followed_from(model, best.point, _SCAN_STEPS, budget)


def certified(model: StemModel, point: FloatArray) -> Certificate:
    """Return the certificate of the fit at this point (p,)."""
    simulated_m = model.simulate(point)
    if simulated_m is None:
        return Certificate(math.inf, math.inf, 0)
    residual = (model.position_m - simulated_m) * model.weight
    return certify(residual, model.weight, bent_rows(simulated_m, model.weight))
