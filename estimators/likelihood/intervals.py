"""What the fit knows: the information of the residuals and priors, in the parameters' own units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.identifiability.bound import Knowledge, knowledge
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.descent import descend
from estimators.likelihood.elimination import FEW_ERRORS, eliminated
from estimators.likelihood.far_places import (
    FOLLOWING_STEPS,
    next_teeth,
    with_limit_at_speed,
    with_other_limits,
    with_other_stiction,
    with_other_value,
)
from estimators.likelihood.limit_median import median_place
from estimators.likelihood.model import STEP, StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.ramps import Ramps
from estimators.likelihood.valley import FARTHEST, WALKED, walk
from estimators.likelihood.valley_of_jumps import FOR_JUMPS, far_walk_of_jumps, is_charted
from estimators.samples import FloatArray

_PIECES: Final = (1, 4, 16, 64, 256, 1024)
_FEWEST_PIECES: Final = 20
_FAINT: Final = 0.1  # of a standard deviation that a unit of a coordinate moves all samples together
_LARGER_STEP: Final = 1.0e-3
_FARTHER: Final = 3  # times a factor of 10, where the cost has not risen there
_STRIDE: Final = 0.6  # of a logarithm
_ALL_THE_WAY: Final = 0.99
_LOWER_TOOTH: Final = 1.0  # of the cost
CHECKED: Final[tuple[str, ...]] = ("m", "F_v", "F_c", "F_s", "DV")
# What may be far off where DV is at the ramp's speed; the intervals of m hold often enough by what is usual.
_FRICTION: Final[tuple[str, ...]] = ("F_v", "F_c", "F_s", "DV")
_WITHIN_95: Final = 3.84
_WITHIN_SILLS: Final = 9.0
_MOST_WORK: Final = 1.2e6  # of the walks
_MOST_WORK_OF_DOUBTS: Final = 0.6e6
_OF_LIMIT: Final = slice(4, 6)  # among the walks: those of DV, downwards and upwards
_OPENER: Final = 1.5  # times the prior's width: 97 of 100 valves have a DV below the fastest speed then
_SURE: Final = 3.0  # standard errors by which the variance of pieces must exceed that of white noise


def inflation(residual: FloatArray, weight: FloatArray) -> float:
    """Factor on all standard errors for residuals, shape (n,), that are larger than the noise or autocorrelated.

    The square root of the largest ratio of the variance of means of pieces to that of independent samples; 1 where
    that is no more than chance.
    """
    own = residual[weight > 0.0]
    largest = 1.0
    for length in _PIECES:
        pieces = own.size // length
        if pieces < _FEWEST_PIECES:
            break
        sums = own[: pieces * length].reshape(pieces, length).sum(axis=1)
        ratio = float(sums @ sums) / own[: pieces * length].size
        if ratio > 1.0 + _SURE * math.sqrt(2.0 / pieces):
            largest = max(largest, ratio)
    return math.sqrt(largest)


def natural_values(model: StemModel, point: FloatArray) -> dict[str, float]:
    """Return the values by symbol, in the order of the coordinates; F_s takes the place of d."""
    values = model.coordinates.values(point)
    return {
        ("F_s" if name == "d" else name): (values["F_c"] * (1.0 + value) if name == "d" else value)
        for name, value in values.items()
    }


def known(model: StemModel, point: FloatArray, ramps: Ramps, *, noise_factor: float) -> Knowledge | None:
    """Return what is known at ``point`` (p,), with all standard errors of the residuals times ``noise_factor``.

    Many errors of the input are eliminated first, which leaves the same information of the others.
    """
    near = eliminated(model, point) if len(model.deviations) > FEW_ERRORS else None
    if near is not None:
        # what is faint is so before the errors are taken out
        model, point = replace(near.model, spread=None), point[: near.count]
    slopes = model.slopes(point)
    if slopes is None:
        return None
    size = np.sqrt(np.einsum("ij,ij->i", slopes, slopes))
    if bool((size < _FAINT).any()):
        # what hardly moves the stem would drown in rounding at the usual step
        steps = np.where(size < _FAINT, _LARGER_STEP, STEP)
        faint = [int(number) for number in np.flatnonzero(size < _FAINT)]
        larger = model.slopes(point, faint, steps)
        if larger is not None:
            slopes[faint] = larger[faint]
    if near is not None:
        slopes -= (slopes @ near.spread) @ near.spread.T
    normal = slopes @ slopes.T / noise_factor**2 + np.diag(model.coordinates.prior_weight)
    change = _change(model, point)
    values = {name: value for name, value in natural_values(model, point).items() if not name.startswith("input_")}
    return knowledge(
        tuple(values),
        tuple(values.values()),
        _without_last(change.T @ normal @ change, len(values)),
        sliding_speeds_m_per_s=ramps.speeds_m_per_s,
        ramp_rates_n_per_s=ramps.rates_n_per_s,
        widest=_widest(model),
    )


def _widest(model: StemModel) -> dict[str, float]:
    """Standard deviations, s, of an input's unknowns of which nothing but their bounds is known beforehand."""
    return {
        entry.name: (entry.upper - entry.lower) * entry.unit / math.sqrt(12.0)
        for entry in model.coordinates.entries
        if entry.name in model.input_names and math.isinf(entry.prior_sd)
    }


@dataclass(frozen=True, slots=True)
class Flatness:
    """Least standard errors by symbol that the cost leaves, and whether the point is within its own intervals.

    ``lowest`` is the point (p,) at which the walks found the lowest cost. ``to_middle``, (p,), leads from the bottom to
    the median of a DV that hardly shows, about which the errors are then; None where the bottom is the middle.
    """

    least: dict[str, float]
    is_lowest: bool
    lowest: FloatArray
    to_middle: FloatArray | None = None


def flat_errors(
    model: StemModel,
    point: FloatArray,
    *,
    noise_factor: float,
    jumps: bool,
    creeps: bool = False,
    about_middle: bool = False,
    slowest_m_per_s: float = math.inf,
    doubted: tuple[str, ...] = (),
) -> Flatness:
    """Least standard errors of m, F_v, F_c, F_s and DV that the cost itself leaves, far from the point.

    Profile likelihood on blocks of rows: one of them goes on either way, the others follow, and all intervals reach
    whatever costs less than 3.84. The information at the point may be of a kink, or of one bend of a valley; of a stem
    that ``jumps``, but not on the usual ramp, the walks meet sills, so that more is believed possible. One that
    ``creeps``, slower than DV, moves in jumps too, though they be smaller than the noise: their number makes a comb of
    minima, and it is looked whether the next teeth are lower. Of the unknowns ``doubted``, which the information says
    are known, quite other values are tried. ``about_middle``: the errors are those of the median of a
    DV that hardly shows.
    """
    small = compressed(model, keeping=point)
    near_errors = eliminated(small, point) if len(model.deviations) > FEW_ERRORS else None
    if near_errors is not None:
        small, point = near_errors.model, point[: near_errors.count]
    charted = is_charted(small, point) and (jumps or not creeps)
    budget = Budget.limited(FOR_JUMPS if charted else min(Budget.of(small).whole, _MOST_WORK))
    most = budget.most_at_once(small, 0.5)
    near = descend(small, point, most_steps=FOLLOWING_STEPS, most_simulations=most)
    start = Place(near.point, near.cost)
    within = (_WITHIN_SILLS if jumps and not charted else _WITHIN_95) * noise_factor**2
    walks = [
        [start, *_walked(small, start, name, sense, budget=budget, within=within, charted=charted)]
        for name, sense in product(WALKED, (-1, 1))
        if (name, sense) != ("DV", 1)
    ]
    opened, closing = _of_open_limit(small)
    begun = Place(start.point, start.cost - closing(start.point))
    upwards = [begun, *_walked(opened, begun, "DV", 1, budget=budget, within=within, charted=charted)]
    walks.append([Place(place.point, place.cost + closing(place.point)) for place in upwards])
    limited: list[Place] = []
    if not (jumps or creeps):
        limited = list(with_limit_at_speed(opened, begun.point, slowest_m_per_s, budget))
    if not jumps:
        walks += [[start, place] for place in with_other_stiction(small, start.point, budget)]
    more = Budget.limited(_MOST_WORK_OF_DOUBTS)
    walks += [[start, place] for name in doubted for place in with_other_value(small, start.point, name, more)]
    if creeps:
        walks.append([start, *next_teeth(small, start.point, budget)])
        walks += [with_other_limits(small, start, sense, budget, within) for sense in (-1, 1)]
    # blocks have another bottom than all rows, and a walk may find it lower
    lowest = min((place for places in walks for place in places), key=lambda place: place.cost)
    middle = None
    if about_middle and not (jumps or creeps or model.stepped):
        of_limit = [place for places in walks[_OF_LIMIT] for place in places]
        middle = median_place(of_limit, small.coordinates.names.index("DV"), noise_factor=noise_factor)
    # the point of all rows goes to the middle as the blocks' bottom does: the errors are those of what is given there
    values = natural_values(small, lowest.point if middle is None else point + middle - lowest.point)
    least: dict[str, float] = {}
    reached = [(point, CHECKED) for places in walks for point in _within(lowest.cost, places, within)]
    lowest_opened = min(place.cost for place in (*upwards, *limited))
    reached += [(point, _FRICTION) for point in _within(lowest_opened, upwards, within)]
    reached += [(place.point, _FRICTION) for place in limited if place.cost <= lowest_opened + within]
    for far_point, symbols in reached:
        far_values = natural_values(small, far_point)
        for symbol in symbols:
            far = abs(far_values[symbol] - values[symbol]) / NORMAL_95
            least[symbol] = max(least.get(symbol, 0.0), far)
    # the blocks of a staircase's rows, weighted by their instants, have a bottom apart from that of all rows
    # a tooth that is any lower tells that the comb is finer than what the search told apart
    is_lowest = model.stepped or start.cost - lowest.cost <= (min(within, _LOWER_TOOTH) if creeps else within)
    ends = [lowest.point if middle is None else middle, lowest.point]
    if near_errors is not None:
        ends = [near_errors.with_errors(end) for end in ends]
    return Flatness(least, is_lowest, ends[1], None if middle is None else ends[0] - ends[1])


def _of_open_limit(model: StemModel) -> tuple[StemModel, Callable[[FloatArray], float]]:
    """Return the model that knows less of DV beforehand, and what more its cost is in the own one.

    By the usual prior less than one valve in a hundred has a DV above half of the ramp's speed, and a published one
    has: intervals that end where the prior rises, and not the misfit, leave out its F_v and F_c.
    """
    own = model.coordinates
    number = own.names.index("DV")
    wider = (replace(e, prior_sd=_OPENER * e.prior_sd) if e.name == "DV" else e for e in own.entries)
    opened = replace(model, coordinates=Coordinates(tuple(wider)))
    weight = float(own.prior_weight[number] - opened.coordinates.prior_weight[number])
    return opened, lambda point: weight * float(point[number] - own.prior[number]) ** 2


def _walked(
    small: StemModel,
    start: Place,
    name: str,
    sense: int,
    *,
    budget: Budget,
    within: float,
    charted: bool,
) -> list[Place]:
    """Places of a walk until the cost has risen: an unknown that hardly shows goes on in strides, far off."""
    if charted:
        return far_walk_of_jumps(small, start, name, sense, budget=budget, within=within)
    number = small.coordinates.names.index(name)
    places = walk(small, start, name, sense, budget=budget, largest_rise=2.0 * within).places
    for _ in range(_FARTHER):
        rise = places[-1].cost - start.cost if places else math.inf
        if rise > within or abs(float(places[-1].point[number] - start.point[number])) < _ALL_THE_WAY * FARTHEST:
            break
        on = walk(
            small,
            places[-1],
            name,
            sense,
            budget=budget,
            largest_rise=2.0 * within - rise,
            longest=_STRIDE,
        )
        places += on.places
        if not on.places:
            break
    return places


def _within(lowest: float, places: list[Place], rise: float) -> list[FloatArray]:
    """Points (p,) of a walk no more than ``rise`` above the lowest, and where it begins to, linear in its root."""
    found: list[FloatArray] = []
    before: Place | None = None
    for place in places:
        if place.cost - lowest <= rise:
            found.append(place.point)
        elif before is not None and before.cost - lowest <= rise:
            root = math.sqrt(before.cost - lowest)
            share = (math.sqrt(rise) - root) / (math.sqrt(place.cost - lowest) - root)
            found.append(before.point + share * (place.point - before.point))
        before = place
    return found


def _without_last(information: FloatArray, kept: int) -> FloatArray:
    """Information of the first ``kept`` unknowns, the others unknown too: Schur's complement."""
    if kept == information.shape[0]:
        return information
    first, between, last = information[:kept, :kept], information[:kept, kept:], information[kept:, kept:]
    return np.asarray(first - between @ np.linalg.solve(last, between.T))


def _change(model: StemModel, point: FloatArray) -> FloatArray:
    """Derivatives of the coordinates to the values by symbol, shape (p, p)."""
    entries, values = model.coordinates.entries, model.coordinates.values(point)
    change = np.diag([1.0 / entry.slope(float(at)) for entry, at in zip(entries, point, strict=True)])
    names = model.coordinates.names
    d, coulomb = names.index("d"), names.index("F_c")
    change[d, d] = 1.0 / values["F_c"]
    change[d, coulomb] = -(1.0 + values["d"]) / values["F_c"]
    return change
