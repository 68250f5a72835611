"""Valves that stick and slip in a measured cycle: of one mass, damping and DV, the F_s - F_c that gives the cycle.

A search from other places does not come to them: unless the cycle is right to a part in a thousand, the simulated stem
is out of step with the measured one after some hundred jumps, and no better than one that slides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np

from estimators.likelihood.all_rows import certified
from estimators.likelihood.arrival import led_to
from estimators.likelihood.compression import bent_rows, compressed, in_parts
from estimators.likelihood.descent import descend
from estimators.likelihood.jump_cycle import JumpCycle, is_waved, jump_cycles
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place
from estimators.likelihood.search import Found
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from valve.errors import MotionError
from valve.motion import simulate_motion
from valve.parameters import ValveParameters
from valve.stem import Mode, StemState

# Own choices, from random valves that stick and slip between the rows.
_PERIODS: Final = (0.1, 0.3, 0.5, 0.65, 0.75, 0.8, 0.85, 0.9, 0.94, 0.97)  # of the stem's swing, in cycles
_DAMPINGS: Final = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
_LIMITS: Final = (0.003, 0.02)  # DV, of the ramp's speed
_MASSES_KG: Final = (0.01, 200.0)
_FORCES: Final = (0.01, 0.55)  # of what the ramp adds in a cycle: F_s - F_c
_HALVINGS: Final = 24
_NEAR: Final = 1.0e-5  # of F_s - F_c
_SAME: Final = 1.0e-3  # of the cycle
_RUN: Final = 7  # cycles, of which the first two come to be like the others
_PLACES: Final = 64  # of a cycle
_EVENTS: Final = 200
_EVENTS_A_CYCLE: Final = 6
_MOST_EVENTS: Final = 12_000
# places that are followed, rests from one new beginning to the next (0: none), what is held, and steps
_MOST_LIKE: Final = (14, 5, 5)
_ROUNDS: Final = (
    (24, 1, ("m", "F_v", "DV"), 3),
    (12, 1, (), 6),
    (6, 1, (), 10),
    (3, 3, (), 10),
    (3, 0, (), 15),
    (3, 0, (), 30),
)
_AS_LOW: Final = 3.0  # times the noise that is left, squared: where two starts end
_FEW_CALM: Final = 8  # rows
_SURE: Final = 4.0  # standard errors of a variance
_UNLIKE: Final = 0.05  # of the wave's square: more is no wave of jumps
_MUCH_LOWER: Final = 0.6  # times the cost at first, where the stem begins anew at its rests
_LEAST_RATIO: Final = 1.0e-3
_COARSE: Final = 0.3  # of the cost
_LOWER: Final = 25.0  # of the cost
_SURELY_LESS: Final = 0.8  # of the noise
_FEW_ROWS: Final = 8_000
_SHARPER: Final = 10.0  # times the weights: what was taken for noise is what has to be followed
_GRID: Final = 0.5  # of the noise: a sensor's steps, whose errors are no wave of the stem


def with_jump_cycle(found: Found, motion: RecordedMotion, rests: Restarts) -> Found:
    """Return the fit of a stem that jumps in the cycle that the position shows, where that is far lower.

    What the fit leaves looks like a wave then, and not like noise: where the jumps were taken for noise it is as large
    as that. The noise is set to what the better fit leaves. A fit that is not good then is not taken.
    """
    model, samples = found.model, motion.samples
    residual = model.residuals(found.point)
    if residual is None or samples.position_step_m > _GRID * samples.position_noise_m:
        return found
    if not is_waved(residual[model.weight > 0.0]):
        return found
    here = model.coordinates.values(found.point)
    cycles = [
        cycle for cycle in jump_cycles(samples, model.corners(here)) if _EVENTS_A_CYCLE * cycle.count < _MOST_EVENTS
    ]
    if not cycles:
        return found
    most = _EVENTS_A_CYCLE * max(cycle.count for cycle in cycles)
    model = replace(model, most_events=max(model.most_events, most), events=max(model.events, most // 2))
    points: list[FloatArray] = []
    for cycle, most_like in zip(cycles, _MOST_LIKE, strict=False):
        alike = sorted(_valves(here, motion, cycle), key=lambda valve: valve[0])[:most_like]
        points += [model.coordinates.point(values) for unlike, values in alike if unlike < _UNLIKE]
    places = _lowest(model, rests, points, found.point)
    if not places or not places[0].cost < model.cost(found.point) - _LOWER:
        return found
    led = led_to(replace(found, model=model), places[0].point)
    if led is None:
        return found
    led = _with_its_noise(led)
    if not led.certificate.is_good:
        return found
    factor = led.noise_factor / found.noise_factor
    # a noise that is what the fit leaves does not speak against the fit: two starts have to come to it, and the rests
    is_one = len(places) > 1 and places[1].cost < places[0].cost + (_AS_LOW * factor) ** 2
    return replace(led, is_confirmed=factor == 1.0 or (is_one and _rests_as_much(led)))


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


def _lowest(model: StemModel, rests: Restarts, points: list[FloatArray], before: FloatArray) -> list[Place]:
    """Return where the best of these points (p,) lead to, lowest first; the noise comes down with what they leave.

    None of them does where the first steps come no lower than ``before``, shape (p,), by much.

    The stem begins anew at the measured rests first: it turns in the midst of a jump, and how far it still goes there,
    hence when it jumps on the next ramp, hangs on the least difference before.
    """
    places = [Place(point, 0.0) for point in points]
    models = {spacing: _parts(model, rests, spacing) for spacing in {spacing for _, spacing, _, _ in _ROUNDS}}
    factor = 1.0
    for kept, spacing, held, steps in _ROUNDS:
        own = replace(models[spacing], weight=models[spacing].weight / factor)
        begun = sorted((Place(place.point, own.cost(place.point)) for place in places), key=lambda place: place.cost)
        places = []
        for place in begun[:kept]:
            if math.isfinite(place.cost):
                few = descend(own, place.point, most_steps=steps, held=held, one_sided=True, arrived=_COARSE)
                places.append(Place(few.point, few.cost))
        places.sort(key=lambda place: place.cost)
        if not places or (held and places[0].cost > _MUCH_LOWER * own.cost(before)):
            return []
        # what jumps were taken for noise lets descents end where they still differ
        factor *= min(1.0, _ratio(own, places[0].point))
    return [Place(place.point, model.cost(place.point)) for place in places]


def _parts(model: StemModel, rests: Restarts, spacing: int) -> StemModel:
    """Return the model that begins anew at each ``spacing``-th rest, of blocks within which the jumps are straight."""
    own = model if spacing == 0 else in_parts(model, rests, spacing)
    if own.time_s.size < _FEW_ROWS:
        return own
    small = compressed(replace(own, weight=_SHARPER * own.weight))
    return replace(small, weight=small.weight / _SHARPER)


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


def _valves(
    here: dict[str, float], motion: RecordedMotion, cycle: JumpCycle
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield values by name of valves that jump in this cycle, with the mean friction that the ramps show.

    Before them, how far their jumps are from the measured wave, as a share of its square: by the amplitudes alone, for
    the least error of k and F_0 puts them out of step.
    """
    uniform, k = motion.uniform, here["k"]
    moving_n, preload_n = here["F_c"] + here["F_v"] * cycle.rate_n_per_s / k, here["F_0"]
    if uniform is not None and uniform.preload_n is not None:
        k, moving_n, preload_n = uniform.spring_n_per_m, uniform.friction_n, uniform.preload_n
    speed = cycle.rate_n_per_s / k
    for share, damping, limit in product(_PERIODS, _DAMPINGS, _LIMITS):
        mass_kg = k * (share * cycle.period_s / (2.0 * math.pi)) ** 2
        if not _MASSES_KG[0] < mass_kg < _MASSES_KG[1]:
            continue
        viscous = 2.0 * damping * math.sqrt(k * mass_kg)
        solved = _stiction(cycle, mass_kg, k, viscous, limit * speed)
        if solved is None:
            continue
        more_n, below_n, waves_m = solved
        off_m = waves_m[: cycle.waves_m.size] - cycle.waves_m
        unlike = float(off_m @ off_m) / float(cycle.waves_m @ cycle.waves_m)
        coulomb_n = moving_n + below_n - more_n
        if coulomb_n > 0.0:
            changed = {"m": mass_kg, "k": k, "F_v": viscous, "F_c": coulomb_n, "d": more_n / coulomb_n}
            yield unlike, here | changed | {"DV": limit * speed, "F_0": preload_n}


def _stiction(
    cycle: JumpCycle, mass_kg: float, spring: float, viscous: float, limit: float
) -> tuple[float, float, FloatArray] | None:
    """F_s - F_c with which the stem jumps in this cycle, how far the mean friction is below F_s, N, and the wave's
    amplitude and those of its overtones, m.

    None where no F_s - F_c gives the cycle: the stem slides, or its swing is slower.
    """
    gained_n = cycle.period_s * cycle.rate_n_per_s
    low_n, high_n = _FORCES[0] * gained_n, _FORCES[1] * gained_n

    def valve(more_n: float) -> ValveParameters:
        return ValveParameters(mass_kg, spring, viscous, gained_n, gained_n + more_n, limit, 0.0)

    if _rests_s(valve(high_n), cycle) is None:
        return None
    for _ in range(_HALVINGS):
        middle_n = math.sqrt(low_n * high_n)
        rests_s = _rests_s(valve(middle_n), cycle)
        if rests_s is None or _period(rests_s) < cycle.period_s:
            low_n = middle_n
        else:
            high_n = middle_n
        if high_n < (1.0 + _NEAR) * low_n:
            break
    rests_s = _rests_s(valve(high_n), cycle)
    if rests_s is None or abs(_period(rests_s) / cycle.period_s - 1.0) > _SAME:
        return None
    out_s = np.linspace(rests_s[-2], rests_s[-1], _PLACES, endpoint=False)
    begin_n = gained_n + high_n
    position_m = simulate_motion(valve(high_n), *_ramp(begin_n, cycle), out_s, initial=StemState(0.0)).position_m
    friction_n = float(np.mean(begin_n + cycle.rate_n_per_s * out_s - spring * position_m))
    off_m = position_m - cycle.rate_n_per_s / spring * out_s
    return high_n, begin_n - friction_n, np.abs(np.fft.rfft(off_m))[1:] * 2.0 / _PLACES


def _ramp(begin_n: float, cycle: JumpCycle) -> tuple[list[float], list[float]]:
    end_s = _RUN * cycle.period_s
    return [0.0, end_s], [begin_n, begin_n + cycle.rate_n_per_s * end_s]


def _rests_s(valve: ValveParameters, cycle: JumpCycle) -> list[float] | None:
    """Instants at which the stem comes to rest on a ramp, s, from its third rest on; None where it has too few."""
    corners = _ramp(valve.static_friction_n, cycle)
    try:
        motion = simulate_motion(valve, *corners, [], initial=StemState(0.0), most_events=_EVENTS)
    except MotionError:
        return None
    rests_s: list[float] = motion.events.time_s[motion.events.mode == Mode.STUCK].tolist()
    return rests_s[2:] if len(rests_s) > _RUN // 2 else None


def _period(rests_s: list[float]) -> float:
    return (rests_s[-1] - rests_s[0]) / (len(rests_s) - 1)
