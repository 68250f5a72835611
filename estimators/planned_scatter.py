"""What a packing leaves open of a test that is not done yet: friction that scatters, beside the sensor's noise.

Simple formulas of what n ramps over a travel L tell of a friction that varies. Each breakaway needs another force:
F_s is known to t(n - 1) s / sqrt(n). F_c is the mean over the travel swept: steady motion shows the roughness there,
and a slip, of length 2 (F_s - F_c) / k, runs over it unseen; a wander is unseen between the ramps. What differs
between the directions looks like a force of the spring, at L / (2 l) places of the correlation length l. m and F_v
are told by the slips, whose drive F_s - F_c the roughness disturbs, m by its shorter time m / F_v beside F_v / k;
F_v also by ramps of several speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import NORMAL_95, student_95
from estimators.samples import FloatArray
from valve.messages import say
from valve.nameplate import Actuator
from valve.packing import packing_preset
from valve.parameters import ValveParameters
from valve.waveform import Waveform

_USUAL: Final = packing_preset("usual")
_FEWEST: Final = 2  # breakaways or ramps that show a scatter
_STILL_S: Final = 0.05  # a shorter hold is a corner
# Of a straight line through evenly spread places it is sqrt(12); the rests at both ends of the travel tell more.
_SLOPE: Final = 3.0
# How late position and pressure may be beside each other, s: their filters (make bench ARGS=rough_valves).
_LATE_S: Final = 3.0e-4
_MEAN_OF_BOTH: Final = math.sqrt(0.5 + 0.5 * _USUAL.roughness_common)  # of two directions with a part in common

_SOURCE: Final = say("usual_packing", "a usual packing")


@dataclass(frozen=True, slots=True)
class PackingScatter:
    """How friction varies, as standard deviations in shares of F_s (``breakaway``) and of F_c, and where it is from."""

    breakaway: float = _USUAL.breakaway_scatter
    roughness: float = _USUAL.roughness
    wander: float = _USUAL.wander
    source: str = _SOURCE  # "Friction varies as that of ..."


@dataclass(frozen=True, slots=True, eq=False)
class Ramps:
    """The ramps that move the stem: the travel of each, m, shape (n,), and the middle of all travel swept, m."""

    swept_m: FloatArray
    middle_m: float


def ramps_of(waveform: Waveform, area_m2: float, parameters: ValveParameters, start_m: float) -> Ramps:
    """Return the ramps that move a stem that rests at ``start_m``, followed without inertia."""
    time_s, force_n = waveform.time_s, area_m2 * waveform.pressure_pa - parameters.preload_n
    turns_n = [float(force_n[0])]
    sense = 0.0
    for run_s, rise_n in zip(np.diff(time_s).tolist(), np.diff(force_n).tolist(), strict=True):
        if rise_n == 0.0:
            # after a hold the stem breaks away anew, whichever way it goes on
            sense = 0.0 if run_s > _STILL_S else sense
        elif math.copysign(1.0, rise_n) == sense:
            turns_n[-1] += rise_n
        else:
            turns_n.append(turns_n[-1] + rise_n)
            sense = math.copysign(1.0, rise_n)
    friction_n, spring = parameters.coulomb_friction_n, parameters.spring_rate_n_per_m
    places_m = [start_m]
    for turn_n in turns_n[1:]:
        low_m, high_m = (turn_n - friction_n) / spring, (turn_n + friction_n) / spring
        place_m = min(max(places_m[-1], low_m), high_m)
        if place_m != places_m[-1]:
            places_m.append(place_m)
    return Ramps(np.abs(np.diff(places_m)), 0.5 * (min(places_m) + max(places_m)))


def packing_half_widths(
    parameters: ValveParameters,
    waveform: Waveform,
    actuator: Actuator,
    scatter: PackingScatter,
    *,
    start_m: float = 0.0,
) -> dict[str, float]:
    """Return half of the 95 % interval that the packing alone leaves, SI, by symbol; infinite where nothing is known.

    ``start_m`` is where the stem rests beforehand. Raises ValueError without a diaphragm area.
    """
    if actuator.diaphragm_area_m2 is None:
        raise ValueError("packing: the actuator has no diaphragm area, give one")
    ramps = ramps_of(waveform, actuator.diaphragm_area_m2, parameters, start_m)
    count = int(ramps.swept_m.size)
    if count < _FEWEST:
        return dict.fromkeys(parameters.by_symbol(), math.inf)
    coulomb_n, static_n = parameters.coulomb_friction_n, parameters.static_friction_n
    spring, damping = parameters.spring_rate_n_per_m, parameters.viscous_friction_n_s_per_m
    rough_n = scatter.roughness * coulomb_n
    range_m = float(np.sqrt(np.mean(ramps.swept_m**2)))
    apart_m = 2.0 * _USUAL.roughness_length * actuator.travel_m
    # a slip runs over the roughness, which is seen in steady motion alone
    slip_m = min(2.0 * (static_n - coulomb_n) / spring, range_m)
    unseen_n = _MEAN_OF_BOTH * rough_n * math.sqrt(slip_m * min(slip_m, apart_m)) / range_m
    wander_n = scatter.wander * coulomb_n * math.sqrt(waveform.duration_s / count / _USUAL.wander_time_s / 6.0 / count)
    rates_n_per_s = actuator.diaphragm_area_m2 * np.abs(np.diff(waveform.pressure_pa)) / np.diff(waveform.time_s)
    late_n = _LATE_S * float(np.median(rates_n_per_s[rates_n_per_s > 0.0]))
    # the drive of a slip is F_s - F_c
    slips = rough_n / max(static_n - coulomb_n, rough_n) / math.sqrt(count)
    # ramps at several speeds meet the same roughness, each in another moment of the wander
    spread_n = float(np.std(rates_n_per_s[rates_n_per_s > 0.0])) / spring * damping
    by_rates = scatter.wander * coulomb_n / math.sqrt(count) / max(spread_n, 1.0e-9 * coulomb_n)
    viscous = 1.0 / math.hypot(1.0 / max(slips, 1.0e-9), 1.0 / max(by_rates, 1.0e-9))
    viscous_n = viscous * damping * float(ramps.swept_m.sum()) / waveform.duration_s
    friction_n = math.hypot(unseen_n, wander_n, viscous_n, 0.5 * late_n)
    # what differs between the directions acts on the stem as a force that changes along the travel
    own_n = 0.5 * rough_n * math.sqrt(min(1.0, apart_m / range_m))
    slope_n_per_m = _SLOPE * own_n / range_m
    students = student_95(count - 1)
    breakaway_n = students * scatter.breakaway * static_n / math.sqrt(count)
    times = max(1.0, damping**2 / (spring * parameters.mass_kg))
    # F_s + sqrt(2 m DV r) is what a breakaway at a force rate r needs
    creep_n = math.sqrt(2.0 * parameters.mass_kg * parameters.limit_velocity_m_per_s * float(rates_n_per_s.max()))
    return {
        "m": NORMAL_95 * slips * times * parameters.mass_kg,
        "k": NORMAL_95 * slope_n_per_m,
        "F_v": NORMAL_95 * viscous * damping,
        "F_c": NORMAL_95 * friction_n,
        "F_s": math.hypot(breakaway_n, NORMAL_95 * friction_n, NORMAL_95 * late_n),
        "DV": 2.0 * breakaway_n / creep_n * parameters.limit_velocity_m_per_s,
        "F_0": NORMAL_95 * math.hypot(own_n, slope_n_per_m * ramps.middle_m),
    }
