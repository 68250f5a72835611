"""Valves that stick and slip in a measured cycle: of one mass, damping and DV, the F_s - F_c that gives the cycle.

A search from other places does not come to them: unless the cycle is right to a part in a thousand, the simulated stem
is out of step with the measured one after some hundred jumps, and no better than one that slides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import certified
from estimators.likelihood.arrival import led_to
from estimators.likelihood.bent_valley import chart_of
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import bent_rows, compressed, in_parts
from estimators.likelihood.cycle_valves import valves_beside, valves_like
from estimators.likelihood.dead_time import acting_later
from estimators.likelihood.descent import descend
from estimators.likelihood.hopping import led_along_jumps
from estimators.likelihood.inputs.transducer_path import DEAD_TIME
from estimators.likelihood.jump_cycle import JumpCycle, is_waved, jump_cycles
from estimators.likelihood.level_kernel import level_runs
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place
from estimators.likelihood.search import Found
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray, Samples

# Own choices, from random valves that stick and slip between the rows.
_EVENTS_A_CYCLE: Final = 6
_MOST_EVENTS: Final = 40_000
_MOST_WORK: Final = 15.0e6  # of all cycles
_MORE_WORK: Final = 4.0e6  # from what it came to
_MOST_LIKE: Final = (200, 100, 50, 50)  # valves of a cycle, each cycle's
# places that are followed, rests from one new beginning to the next (0: none), what is held, and steps
_ROUNDS: Final = (
    (36, 1, ("m", "F_v", "DV"), 3),
    (14, 1, (), 6),
    (8, 1, (), 10),
    (5, 3, (), 10),
    (4, 12, (), 10),
    (4, 48, (), 10),
    (4, 192, (), 10),
    (4, 0, (), 15),
    (3, 0, (), 30),
)
_ALWAYS: Final = 3  # rests from one new beginning to the next; more only
_FEWEST_PARTS: Final = 3  # where there are so many parts: a thousand jumps come into step little by little
_JUDGED: Final = 1  # the round after which a cycle is given up
_OFF: Final = {"m": 0.005, "F_v": 0.1, "DV": 0.7}  # of logarithms, from where a fit has to come back
_ALIKE: Final = 0.03  # of m and of F_v, of two places from which one goes on
_AS_LOW: Final = 3.0  # times the noise that is left, squared: where two starts end
_FEW_CALM: Final = 8  # rows
_SURE: Final = 4.0  # standard errors of a variance
_LED: Final = 2  # places that are led down the valley of their jumps
_LED_SHARE: Final = 0.4  # of the budget of a search, for each, and
_LED_AT_LEAST: Final = 400  # simulations
_MUCH_LOWER: Final = 0.6  # times the cost at first, where the stem begins anew at its rests
_LEAST_RATIO: Final = 1.0e-3
_COARSE: Final = 0.3  # of the cost
_LOWER: Final = 25.0  # of the cost
_SURELY_LESS: Final = 0.8  # of the noise
_FEW_ROWS: Final = 8_000
_OTHER_RATE: Final = 0.05
_OF_A_CYCLE: Final = 0.1  # the longest block
_CYCLES_LATER: Final = (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5)
_OF_A_JUMP: Final = 0.15
_REST_ROWS: Final = 3
_LONGER: Final = 1.5  # than a cycle
_GRID: Final = 0.5  # of the noise: a sensor's steps, whose errors are no wave of the stem


def with_jump_cycle(found: Found, motion: RecordedMotion, rests: Restarts) -> Found:
    """Return the fit of a stem that jumps in the cycle that the position shows, where that is far lower.

    It is looked for in the position where the fit is not good, or what it leaves looks like a wave: where the jumps
    were taken for noise it is as large as that; else in what it leaves. The noise is set to what the better fit leaves.
    One that is not good then is taken only for one that is not good either, and explains far less. One to which a
    single start came is not confirmed, nor, where its own noise is all that speaks for it, one that leaves more where
    the stem jumps than at its rests.
    """
    model, samples = found.model, motion.samples
    residual = model.residuals(found.point)
    if residual is None or samples.position_step_m > _GRID * samples.position_noise_m:
        return found
    here = model.coordinates.values(found.point)
    stops_m = here.get("low", -math.inf), here.get("high", math.inf)
    # of a fit that explains all rows a wave within the noise is what it leaves
    hides = found.certificate.is_good and not is_waved(residual[model.weight > 0.0])
    left_m = np.divide(residual, model.weight, out=np.zeros_like(residual), where=model.weight > 0.0) if hides else None
    shown = jump_cycles(samples, model.corners(here), stops_m, left_m)
    cycles = [cycle for cycle in shown if _EVENTS_A_CYCLE * cycle.count < _MOST_EVENTS]
    if not cycles:
        return found
    most = _EVENTS_A_CYCLE * max(cycle.count for cycle in cycles)
    model = replace(model, most_events=max(model.most_events, most), events=max(model.events, most // 2))
    places = _lowest_of(model, motion, cycles, found.point, rests)
    if not places or not model.cost(places[0].point) < model.cost(found.point) - _LOWER:
        return found
    near = led_to(replace(found, model=model), places[0].point)
    if near is None:
        return found
    led = _with_its_noise(near)
    if not led.certificate.is_good:
        # errors of a noisy pressure may be what it leaves, and are fitted later
        is_better = not found.certificate.is_good and near.cost < _MUCH_LOWER * found.cost
        return near if is_better else found
    # a noise that is what the fit leaves does not speak against the fit: the rests have to
    is_own = led.noise_factor == found.noise_factor
    return replace(led, is_confirmed=_is_one(model, places) and (is_own or _rests_as_much(led)))


def _lowest_of(
    model: StemModel, motion: RecordedMotion, cycles: list[JumpCycle], before: FloatArray, rests: Restarts
) -> list[Place]:
    """Return the lowest places to which valves of the first of these cycles lead that comes far below ``before``."""
    here = model.coordinates.values(before)
    budget, is_staircase = Budget.limited(_MOST_WORK), motion.uniform is None
    places: list[Place] = []
    for cycle, most_like in zip(cycles, _MOST_LIKE, strict=False):
        others = [other for other in cycles if abs(other.rate_n_per_s / cycle.rate_n_per_s - 1.0) > _OTHER_RATE]
        points = [model.coordinates.point(values) for values in valves_like(here, motion, cycle, others)[:most_like]]
        if DEAD_TIME in here:
            points = [point for own in points for point in _as_late(model, own, cycle)]
        jump_m = cycle.period_s * cycle.rate_n_per_s / here["k"]
        beside = rests if is_staircase else _rests_beside(motion.samples, cycle.period_s, jump_m)
        begun = _Begun(model, beside if beside.row.size else rests, cycle.period_s)
        places = begun.lowest(points, before, budget) if points else []
        if places and _is_much_lower(model, model.cost(places[0].point), model.cost(before)):
            # along m and F_v that keep the cycle the cost is a comb, and a descent ends at one of its teeth
            near = valves_beside(model.coordinates.values(places[0].point), cycle)
            begins = [model.coordinates.point(values) for values in near]
            again = begun.lowest(begins, before, Budget.limited(_MORE_WORK)) if begins else []
            ended = (Place(place.point, model.cost(place.point)) for place in (*places, *again))
            return sorted(ended, key=lambda place: place.cost)
    return places


def _as_late(model: StemModel, point: FloatArray, cycle: JumpCycle) -> Iterator[FloatArray]:
    """Yield this point (p,) and others with another dead time, whose friction is as much less as the ramp gains in it.

    All along a ramp nothing tells them apart; where it turns, a cycle more or less comes out of step.
    """
    values = model.coordinates.values(point)
    for cycles in _CYCLES_LATER:
        changed = acting_later(values, cycles * cycle.period_s, cycle.rate_n_per_s)
        if changed["F_c"] > 0.0:
            yield model.coordinates.point(changed)


def _rests_beside(samples: Samples, cycle_s: float, jump_m: float) -> Restarts:
    """Return where the stem rests for longer than it does between its jumps, of this length, on a ramp.

    Where jumps were taken for noise, rests that were found by that noise lie in the midst of jumps.
    """
    runs = level_runs(samples.position_m, samples.run_last, _OF_A_JUMP * jump_m, _REST_ROWS)
    runs = runs[samples.time_s[runs[:, 1]] - samples.time_s[runs[:, 0]] > _LONGER * cycle_s]
    inside = [(first + 1, last - 1) if last - first > _REST_ROWS else (first, last) for first, last in runs.tolist()]
    return Restarts(
        np.array([(first + last) // 2 for first, last in inside], dtype=np.int64),
        np.array([float(samples.position_m[first : last + 1].mean()) for first, last in inside]),
    )


def _rests_as_much(found: Found) -> bool:
    """Whether the fit leaves as much where the stem rests as where it jumps, as far as there are rows at rest."""
    model = found.model
    simulated_m = model.simulate(found.point)
    if simulated_m is None:
        return False
    squared = np.square((model.position_m - simulated_m) * model.weight)
    measured = model.weight > 0.0
    calm = measured & ~bent_rows(simulated_m, model.weight)
    rows = int(np.count_nonzero(calm))
    excess = float(squared[measured].mean()) / max(float(squared[calm].mean()), 1.0e-12) - 1.0 if rows else 0.0
    return rows < _FEW_CALM or bool(excess < _SURE * math.sqrt(2.0 / rows))


@dataclass(frozen=True, slots=True, eq=False)
class _Begun:
    """The model of a stem that begins anew at some of its rests, and of one that does not, on blocks by the cycle."""

    model: StemModel
    rests: Restarts
    cycle_s: float

    def lowest(self, points: list[FloatArray], before: FloatArray, budget: Budget) -> list[Place]:
        """Return where the best of these points (p,) lead to, lowest first, by the noise that they leave at last.

        None of them does where the first rounds come no lower than ``before``, shape (p,), by much.

        The stem begins anew at the measured rests first: it turns in the midst of a jump, and how far it still goes
        there, hence when it jumps on the next ramp, hangs on the least difference before.
        """
        places = [Place(point, 0.0) for point in points]
        models: dict[int, StemModel] = {}
        factor, own = 1.0, self.model
        for number, (kept, spacing, held, steps) in enumerate(_ROUNDS):
            if spacing > _ALWAYS and _FEWEST_PARTS * spacing > self.rests.row.size:
                continue
            if spacing not in models:
                models[spacing] = self._parts(spacing)
            own = replace(models[spacing], weight=models[spacing].weight / factor)
            begun = sorted(
                (Place(place.point, own.cost(place.point)) for place in places), key=lambda place: place.cost
            )
            budget.spend(own, len(places))
            places = []
            for place in begun[:kept]:
                if math.isfinite(place.cost) and (budget.left > 0.0 or len(places) < _LED):
                    few = descend(own, place.point, most_steps=steps, held=held, one_sided=True, arrived=_COARSE)
                    budget.spend(own, few.simulations)
                    places.append(Place(few.point, few.cost))
            places = _unlike(own, places) if spacing else sorted(places, key=lambda place: place.cost)
            if not places or (number == _JUDGED and not _is_much_lower(own, places[0].cost, own.cost(before))):
                return []
            # what jumps were taken for noise lets descents end where they still differ
            factor *= min(1.0, _ratio(own, places[0].point))
        work = max(_LED_SHARE * Budget.of(self.model, jumps=True).whole, Budget.price(own, _LED_AT_LEAST))
        places = [led_along_jumps(own, place, Budget.limited(work), 0.0) for place in places[:_LED]]
        places.sort(key=lambda place: place.cost)
        if not _is_one(own, places):
            beside = [led_along_jumps(own, place, Budget.limited(work), 0.0) for place in _beside(own, places[0])]
            places = sorted([*places, *beside], key=lambda place: place.cost)
        return places

    def _parts(self, spacing: int) -> StemModel:
        """Return the model that begins anew at each ``spacing``-th rest, of blocks within which the jumps are straight.

        Within the noise of a row they are too, so that no block is longer than a part of the cycle.
        """
        own = self.model if spacing == 0 else in_parts(self.model, self.rests, spacing)
        return own if own.time_s.size < _FEW_ROWS else compressed(own, longest_s=_OF_A_CYCLE * self.cycle_s)


def _is_much_lower(model: StemModel, cost: float, before: float) -> bool:
    """Whether this cost is far below the one before, or what is left of it beyond the noise."""
    rows = float(np.count_nonzero(model.weight))
    return cost < _MUCH_LOWER * before or cost - rows < _MUCH_LOWER * (before - rows)


def _is_one(model: StemModel, places: list[Place]) -> bool:
    """Whether the two lowest of these places are one bottom, or two as low."""
    if len(places) < 2:
        return False
    return places[1].cost < places[0].cost + _AS_LOW**2 or _is_near(model, places[0], places[1])


def _beside(model: StemModel, place: Place) -> Iterator[Place]:
    """Yield places with another mass, damping and DV and the same jumps: what leads back from there is no tooth."""
    chart, names = chart_of(model, place.point), model.coordinates.names
    own = chart.charted(place.point)
    for sense in (-1.0, 1.0):
        beside = (place.point if own is None else own).copy()
        for name, change in _OFF.items():
            beside[names.index(name)] += sense * change
        point = beside if own is None else chart.point(beside)
        if point is not None:
            yield Place(point, model.cost(point))


def _is_near(model: StemModel, place: Place, other: Place) -> bool:
    """Whether two places have about the same m and F_v."""
    compared = [model.coordinates.names.index(name) for name in ("m", "F_v")]
    return float(np.abs((place.point - other.point)[compared]).max()) < _ALIKE


def _unlike(model: StemModel, places: list[Place]) -> list[Place]:
    """Return the places, lowest first, without those whose m and F_v a lower one has already."""
    kept: list[Place] = []
    for place in sorted(places, key=lambda place: place.cost):
        if not any(_is_near(model, place, other) for other in kept):
            kept.append(place)
    return kept


def _ratio(model: StemModel, point: FloatArray) -> float:
    residual = model.residuals(point)
    rows = np.count_nonzero(model.weight)
    return 1.0 if residual is None else max(math.sqrt(float(residual @ residual) / rows), _LEAST_RATIO)


def _with_its_noise(found: Found) -> Found:
    """Return the fit with the noise that it leaves, and the bottom of its cost then."""
    ratio = found.certificate.ratio
    found = replace(found, others=())
    if ratio > _SURELY_LESS:
        return found
    model = replace(found.model, weight=found.model.weight / ratio)
    again = replace(found, model=model, cost=model.cost(found.point), noise_factor=found.noise_factor * ratio)
    again = replace(again, certificate=certified(model, again.point))
    led = led_to(again, again.point)
    return again if led is None else _with_its_noise(led)
