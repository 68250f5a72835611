"""Travel stops inside the sweep: the stem rests at an end although the force exceeds all friction."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.motion.phases import Phases
from estimators.motion.static_friction import breakaway_forces
from estimators.motion.uniform_motion import UniformMotion
from estimators.samples import BoolArray, Samples
from valve.parameters import TravelStops

# Own choices: what a rest may exceed the friction at breakaway by, and how near to its end a stop's rest lies.
_EXCESS: Final = 1.15
_EXCESS_OF_RANGE: Final = 0.01
_NEAR_THE_END: Final = 0.005


def find_stops(samples: Samples, phases: Phases, uniform: UniformMotion) -> TravelStops | None:
    """Return the stops that the stem rested on, or None; a rest is on one where |F - k x - F_0| is beyond friction."""
    if uniform.preload_n is None:
        return _stop_of_one_way(samples, phases, uniform)
    spring, preload = uniform.spring_n_per_m, uniform.preload_n
    forces = breakaway_forces(samples, phases, spring, preload)
    friction = uniform.friction_n if forces is None else max(float(forces.friction_n.max()), uniform.friction_n)
    return stops_beyond(samples, phases, (spring, preload), friction)


def stops_beyond(
    samples: Samples, phases: Phases, line: tuple[float, float], friction_n: float, *, excess: float = _EXCESS
) -> TravelStops | None:
    """Return the stops at the ends of the travel on which the stem rests with |F - k x - F_0| beyond the friction.

    ``line`` are k, N/m, and F_0, N; beyond is ``excess`` times the friction and more.
    """
    spring_n_per_m, preload_n = line
    limit = excess * friction_n + _EXCESS_OF_RANGE * float(np.ptp(samples.force_n)) + 5.0 * samples.force_noise_n
    resting = _resting(samples, phases)
    held_n = samples.force_n - spring_n_per_m * samples.position_m - preload_n
    low_m, high_m = float(samples.position_m.min()), float(samples.position_m.max())
    near = _NEAR_THE_END * (high_m - low_m) + 6.0 * samples.position_noise_m
    on_high = resting & (held_n > limit) & (samples.position_m > high_m - near)
    on_low = resting & (held_n < -limit) & (samples.position_m < low_m + near)
    stops = {}
    if on_high.any():
        stops["high_m"] = float(np.median(samples.position_m[on_high]))
    if on_low.any():
        stops["low_m"] = float(np.median(samples.position_m[on_low]))
    return TravelStops(**stops) if stops else None


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
