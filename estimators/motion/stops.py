"""Travel stops inside the sweep: the stem rests at an end although the force exceeds all friction."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from estimators.motion.phases import After, Phases
from estimators.motion.static_friction import breakaway_forces
from estimators.motion.uniform_motion import UniformMotion
from estimators.samples import BoolArray, Samples
from valve.parameters import TravelStops

# Own choices: what a rest may exceed the friction at breakaway by, and how near to its end a stop's rest lies.
_EXCESS: Final = 1.15
_EXCESS_OF_RANGE: Final = 0.01
_NEAR_THE_END: Final = 0.005
_PAST: Final = 1.02  # times the friction in motion, which stops no stem while the force goes on


def find_stops(samples: Samples, phases: Phases, uniform: UniformMotion) -> TravelStops | None:
    """Return the stops that the stem rested on, or None; a rest is on one where |F - k x - F_0| is beyond friction.

    At breakaway, or, of a motion that ended while the force went on in its direction, that in motion.
    """
    if uniform.preload_n is None:
        return _stop_of_one_way(samples, phases, uniform)
    spring, preload = uniform.spring_n_per_m, uniform.preload_n
    forces = breakaway_forces(samples, phases, spring, preload)
    friction = uniform.friction_n if forces is None else max(float(forces.friction_n.max()), uniform.friction_n)
    ended = _ended_in_motion(samples, phases, (spring, preload), uniform.friction_n)
    return _stops_beyond(samples, phases, (spring, preload), friction, ended)


def _stops_beyond(
    samples: Samples, phases: Phases, line: tuple[float, float], friction_n: float, ended: BoolArray
) -> TravelStops | None:
    """Return the stops at the ends of the travel on which the stem rests with |F - k x - F_0| beyond the friction.

    ``line`` are k, N/m, and F_0, N. ``ended``, shape (n,), are rows of rests that are on a stop for another reason.
    """
    spring_n_per_m, preload_n = line
    limit = _EXCESS * friction_n + _EXCESS_OF_RANGE * float(np.ptp(samples.force_n)) + 5.0 * samples.force_noise_n
    resting = _resting(samples, phases)
    held_n = samples.force_n - spring_n_per_m * samples.position_m - preload_n
    low_m, high_m = float(samples.position_m.min()), float(samples.position_m.max())
    near = _NEAR_THE_END * (high_m - low_m) + 6.0 * samples.position_noise_m
    on_high = resting & ((held_n > limit) | (ended & (held_n > 0.0))) & (samples.position_m > high_m - near)
    on_low = resting & ((held_n < -limit) | (ended & (held_n < 0.0))) & (samples.position_m < low_m + near)
    stops = {}
    if on_high.any():
        stops["high_m"] = float(np.median(samples.position_m[on_high]))
    if on_low.any():
        stops["low_m"] = float(np.median(samples.position_m[on_low]))
    return TravelStops(**stops) if stops else None


def _ended_in_motion(samples: Samples, phases: Phases, line: tuple[float, float], friction_n: float) -> BoolArray:
    """Rows, shape (n,), of rests after a motion that ended while the force went on in its direction.

    In motion the friction is F_c + F_v v: a stem that slides comes to rest where the force comes back. One
    that sticks and slips comes to rest in between too, with up to F_s on it, and is left out.
    """
    held_n = samples.force_n - line[0] * samples.position_m - line[1]
    trifle_n = _EXCESS_OF_RANGE * float(np.ptp(samples.force_n)) + 5.0 * samples.force_noise_n
    ended = np.zeros(samples.count, dtype=np.bool_)
    stretches = phases.stretches
    sticking = {
        after.direction
        for before, after in pairwise(stretches)
        if after.direction == before.direction and after.after is After.BREAKAWAY
    }
    firsts = [*(stretch.first for stretch in stretches[1:]), samples.count]
    for stretch, coming in zip(stretches, firsts, strict=True):
        if not stretch.driven or stretch.direction in sticking:
            continue
        pushed_n = stretch.direction * samples.force_n[stretch.last : coming]
        goes_on = np.cumsum(np.maximum.accumulate(pushed_n) - pushed_n > trifle_n) == 0
        is_past = stretch.direction * held_n[stretch.last : coming] > _PAST * friction_n + trifle_n
        ended[stretch.last : coming] = goes_on & is_past & (pushed_n > pushed_n[0] + trifle_n)
    return ended


def _stop_of_one_way(samples: Samples, phases: Phases, uniform: UniformMotion) -> TravelStops | None:
    """The stop that motion in one direction ended on: the stem rests at its farthest, and the force goes on rising.

    In motion s (F - k x) is A + s F_0 there, which is what is known of friction and preload.
    """
    sense = next(iter(uniform.directions))
    range_n = float(np.ptp(samples.force_n))
    excess = sense * (samples.force_n - uniform.spring_n_per_m * samples.position_m) - uniform.friction_n
    limit = (_EXCESS - 1.0) * abs(uniform.friction_n) + _EXCESS_OF_RANGE * range_n + 5.0 * samples.force_noise_n
    way_m = sense * samples.position_m
    near = _NEAR_THE_END * float(np.ptp(way_m)) + 6.0 * samples.position_noise_m
    on_stop = _resting(samples, phases) & (excess > limit) & (way_m > float(way_m.max()) - near)
    if not on_stop.any():
        return None
    stop_m = float(np.median(samples.position_m[on_stop]))
    return TravelStops(high_m=stop_m) if sense > 0 else TravelStops(low_m=stop_m)


def _resting(samples: Samples, phases: Phases) -> BoolArray:
    """Rows, shape (n,), in which the stem does not move."""
    resting = np.ones(samples.count, dtype=np.bool_)
    for stretch in phases.stretches:
        resting[stretch.rows] = False
    return resting


def rows_off_stops(samples: Samples, stops: TravelStops | None) -> BoolArray:
    """Rows, shape (n,), of which neither they nor the two before touch a stop."""
    if stops is None:
        return np.ones(samples.count, dtype=np.bool_)
    near = 6.0 * samples.position_noise_m + 1.0e-6 * float(np.ptp(samples.position_m))
    touching = (samples.position_m > stops.high_m - near) | (samples.position_m < stops.low_m + near)
    off = ~touching
    off[1:] &= ~touching[:-1]
    off[2:] &= ~touching[:-2]
    return off
