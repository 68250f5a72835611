"""From the recording to the lowest places of the cost: many short descents on few rows, few on all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import (
    MOST_PLACES,
    NEAR,
    certified,
    exactly,
    is_computed,
    on_all_rows,
)
from estimators.likelihood.budget import Budget
from estimators.likelihood.certificate import Certificate
from estimators.likelihood.compression import compressed, in_parts
from estimators.likelihood.confirmation import CONFIRMING_SHARE, SECOND_SHARE, are_as_low, at_one_bottom, led_down_apart
from estimators.likelihood.hopping import Hopping, hopped
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place, chosen_trials, distinct, followed_from, ranked
from estimators.likelihood.searching import Searching
from estimators.likelihood.start import Trial
from estimators.likelihood.thinned_force import thinned
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

# Own choices.
_SCAN_STEPS: Final = 7
_FIRST_STARTS: Final = 20  # which the first search follows
_RANKING_SHARE: Final = 0.2  # of the budget
_REFILL: Final = 0.35  # of the budget, where what was found is not enough
_MORE_SEARCHES: Final = 2  # where the best does not explain the recording
_SURELY_LESS: Final = 0.8  # of the noise: it was overestimated
_SPACING: Final = 4
_EVENTS_A_BREAKAWAY: Final = 3
_MORE_EVENTS: Final = 10  # times the measured stem's: a trial valve that chatters
_FEW_EVENTS: Final = 40
_MOST_HIDDEN: Final = 12_000  # followed in 3 ms
_STILL_SIGMAS: Final = 4.0
_LEAST_REST_ROWS: Final = 3
_SHORTEST_REST: Final = 0.03  # of the median one: what looks still for so short a time is the end of a jump


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
    rests: list[tuple[int, float]] = []
    between = [(before.last + 1, after.first - 1) for before, after in pairwise(stretches)]
    usual = float(np.median([last - first + 1 for first, last in between])) if between else 0.0
    for first, last in between:
        if last - first + 1 < max(_LEAST_REST_ROWS, _SHORTEST_REST * usual):
            continue
        own_m = samples.position_m[first : last + 1]
        half = own_m.size // 2
        drift_m = abs(float(own_m[half:].mean() - own_m[:half].mean()))
        limit_m = _STILL_SIGMAS * samples.position_noise_m + 1.0e-9 * float(np.ptp(samples.position_m))
        if drift_m <= limit_m * math.sqrt(2.0 / half) and float(np.ptp(own_m)) <= 2.5 * limit_m:
            rests.append(((first + last) // 2, float(own_m.mean())))
    return Restarts(np.array([row for row, _ in rests], dtype=np.int64), np.array([at_m for _, at_m in rests]))


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
    budget = Budget.of(model, jumps=hopping.jumps)
    limited = replace(model, most_events=min(model.most_events, _MORE_EVENTS * (model.events + _FEW_EVENTS)))
    limited = thinned(limited, trials[0].values)
    limited.corners(trials[0].values)
    small = compressed(limited)
    stages = stages_of(limited, rests, jumps=hopping.jumps)
    whole = budget.left
    first = ranked(stages[0], chosen_trials(trials, budget.most_simulations(stages[0], _RANKING_SHARE)), budget)
    if not first:
        return None
    found = Searching(limited, small, stages, rests, hopping)
    places = found.lowest(first, budget)
    apart: list[Place] = []
    if hopping.jumps:
        second = Budget.limited(SECOND_SHARE * whole)
        starts = first[_FIRST_STARTS:]
        if places:
            near = [_with_its_balance(small, trial, places[0]) for trial in trials]
            starts = ranked(stages[0], chosen_trials(near, second.most_simulations(stages[0], _RANKING_SHARE)), second)
        apart = found.lowest(starts, second)[:1]
        budget.simulations += second.simulations
        budget.starts += second.starts
        apart = [*places[:1], *apart] if places and apart else []
        apart = led_down_apart(small, apart, Budget.limited(CONFIRMING_SHARE * whole))
        places = distinct(small, [*places, *apart])
    if not places:
        return None
    factor = 1.0
    ended = on_all_rows(model, places, budget)
    if not ended:
        return None
    certificate = certified(model, ended[0].point)
    searches = 0
    while True:
        if _takes_motion_for_noise(model, certificate):
            factor *= certificate.ratio
            model = replace(model, weight=model.weight / certificate.ratio)
            small = compressed(replace(model, most_events=limited.most_events))
            budget.left = max(budget.left, _REFILL * whole)
            again = [Place(place.point, small.cost(place.point)) for place in [*ended, *places]]
            ended = on_all_rows(model, hopped(small, distinct(small, again), hopping, budget, whole), budget)
            certificate = certified(model, ended[0].point)
            continue
        if certificate.is_good or certificate.ratio < exactly(model) or searches == _MORE_SEARCHES:
            break
        searches += 1
        budget.left = max(budget.left, _REFILL * whole)
        known = [Place(place.point, small.cost(place.point)) for place in [*ended, *places]]
        more = [hopped(small, [place], hopping, budget, whole) for place in distinct(small, known)[:MOST_PLACES]]
        places = distinct(small, [place for some in more for place in some])
        ended = on_all_rows(model, places, budget) or ended
        certificate = certified(model, ended[0].point)
    if not hopping.jumps and certificate.ratio > exactly(model) and _creeps(model, ended[0], hopping):
        budget.left = max(budget.left, _REFILL * whole)
        model = replace(model, most_events=max(model.most_events, _MOST_HIDDEN))
        ended = _of_many_events(model, small, ended, hopping, budget)
        certificate = certified(model, ended[0].point)
    # a delay that comes in later may be what the best does not explain: then as far as the coarser blocks tell
    is_confirmed = not hopping.jumps or are_as_low(small, ended[0], apart, certificate.ratio)
    if hopping.jumps and certificate.is_good:
        ended, is_confirmed = at_one_bottom(model, ended, apart, found, budget)
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
        is_confirmed,
    )


def _takes_motion_for_noise(model: StemModel, certificate: Certificate) -> bool:
    """Whether the fit leaves so little that the position's differences saw its motion as noise.

    Rows of unequal weights leave less than their errors where these repeat: that is no noise taken too large.
    """
    is_even = float(np.ptp(model.weight[model.weight > 0.0])) == 0.0
    return is_even and not is_computed(model) and 0.0 < certificate.ratio < _SURELY_LESS


def _creeps(model: StemModel, place: Place, hopping: Hopping) -> bool:
    """Whether the stem is slower than its DV at this place: it goes in jumps that may be too small to be seen."""
    own = model.coordinates.values(place.point)
    return own["DV"] * own["k"] > hopping.slowest_n_per_s


def _of_many_events(
    model: StemModel, small: StemModel, ended: list[Place], hopping: Hopping, budget: Budget
) -> list[Place]:
    """Hop from the best of a stem that creeps, where trial valves may have thousands of jumps, as the right one may."""
    many = replace(small, most_events=model.most_events)
    known = distinct(many, [Place(one.point, many.cost(one.point)) for one in ended])
    more = on_all_rows(model, hopped(many, known, hopping, budget, budget.left), budget)
    return distinct(model, [*more, *ended])


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


def stages_of(model: StemModel, rests: Restarts, *, jumps: bool) -> list[StemModel]:
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
    ended = hopped(small, distinct(small, places), hopping, budget, budget.left)
    return ended[0].point if ended else found.point
