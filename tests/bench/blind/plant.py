"""The valves of the blind tests and how they move: fixed steps throughout, none of the kernel that fits.

Shared with the product are only the slots' names (valve.extended_valve) and which of them an effect fills
(valve.effects). The input path is answered here too, so that what the pressure channel shows is what acted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from tests.bench.blind.oddities import Oddity, Steps
from tests.bench.blind.strengths import Swept
from tests.support.extended_reference import integrate
from valve.effects import ValveScale
from valve.extended_valve import ExtendedValve, InputPath
from valve.nameplate import Action, Actuator, Nameplate, Signal
from valve.parameter_sets import parameter_set
from valve.parameters import ValveParameters, parameters_from_symbols
from valve.recording import FloatArray
from valve.waveform import Waveform

VALVES: Final = ("vendor", "nominal", "rough", "graphite")
SCATTER: Final = 0.3
STEPS: Final = Steps(5.0e-6, 1.0e-4)
PATH_STEP_S: Final = 2.5e-4
# Before the record begins the stem rests at the first pressure for so long: the graphite valve settles in 6 x 0.34 s.
SETTLING_S: Final = 2.0
_LEAST_SWEPT: Final = 0.3  # of the travel: a stickier valve than that is hardly tested by any sequence
_BOTH_WAYS: Final = 0.1  # of all that it sweeps
_PRELOAD: Final = 0.08  # of the spring's range, at most, where the published valve has none
# Above the ramp's speed, as published, it creeps in thousands of micro-steps, and fixed steps are 2 to 3 um rms off.
_GRAPHITE_LIMIT: Final = (0.01, 0.1)  # DV as a share of the travel over a slow ramp's 11 s
_OVER_RANGE: Final = 0.5  # of F_c by which a test goes beyond the bench set, at most


@dataclass(frozen=True, slots=True)
class Plant:
    """A healthy valve, its nameplate with the bench set, and the levels that its tests go between, Pa (or N)."""

    name: str
    parameters: ValveParameters
    nameplate: Nameplate
    low: float
    high: float

    @property
    def area_m2(self) -> float:
        """Diaphragm area, m2; 1 where the level is a force."""
        return self.nameplate.actuator.diaphragm_area_m2 or 1.0

    def swept(self, wave: Waveform) -> Swept:
        """What a waveform sweeps of it."""
        p = self.parameters
        k = p.spring_rate_n_per_m
        travel_m = self.nameplate.actuator.travel_m
        full_n = self.area_m2 * self.high
        if k == 0.0:
            speed = max(full_n - p.coulomb_friction_n, 0.0) / p.viscous_friction_n_s_per_m / 2.0
            return Swept(0.0, travel_m, speed, wave.duration_s, ValveScale.of(p, travel_m, full_n))
        low_m = (self.area_m2 * self.low - p.preload_n + p.coulomb_friction_n) / k
        high_m = (full_n - p.preload_n - p.coulomb_friction_n) / k
        rate = np.abs(np.diff(wave.pressure_pa)) / np.maximum(np.diff(wave.time_s), 1.0e-9)
        slowest = float(rate[rate > 0.0].min())
        scale = ValveScale.of(p, travel_m, full_n)
        return Swept(low_m, high_m, self.area_m2 * slowest / k, wave.duration_s, scale)


def drawn_plant(name: str, rng: np.random.Generator, *, bench_set_known: bool = True) -> Plant:
    """This published valve with every parameter scattered, redrawn until it moves far enough to be tested."""
    published = parameter_set(name)
    base, plate = published.parameters.by_symbol(), published.nameplate
    travel_m, area_m2 = plate.actuator.travel_m, plate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    while True:
        values = {symbol: base[symbol] * float(rng.uniform(1.0 - SCATTER, 1.0 + SCATTER)) for symbol in base}
        excess = (base["F_s"] / base["F_c"] - 1.0) * float(rng.uniform(1.0 - SCATTER, 1.0 + SCATTER))
        values["F_s"] = values["F_c"] * (1.0 + excess)
        range_n = values["k"] * travel_m
        if base["F_0"] == 0.0:
            values["F_0"] = float(rng.uniform(0.0, _PRELOAD)) * range_n
        if name == "graphite":
            values["DV"] = float(rng.uniform(*_GRAPHITE_LIMIT)) * travel_m / 11.0
        over_n = rng.uniform(0.0, _OVER_RANGE, 2) * values["F_c"]
        low_n, high_n = max(0.0, values["F_0"] - over_n[0]), values["F_0"] + range_n + over_n[1]
        if (high_n - low_n - 2.0 * values["F_c"]) / values["k"] > _LEAST_SWEPT * travel_m:
            break
    bench_pa = (values["F_0"] / area_m2, (values["F_0"] + range_n) / area_m2)
    actuator = replace(plate.actuator, bench_set_pa=bench_pa if bench_set_known else None)
    signal = Signal((4.0, 20.0), (low_n / area_m2, high_n / area_m2))
    nameplate = Nameplate(f"BLIND-{name}", actuator, signal)
    return Plant(name, parameters_from_symbols(values), nameplate, low_n / area_m2, high_n / area_m2)


def drawn_drive(rng: np.random.Generator) -> Plant:
    """A drive without a spring under a measured force that goes both ways, of the size of the EMPS."""
    F_c = float(rng.uniform(15.0, 26.0))
    F_v = float(rng.uniform(150.0, 260.0))
    mass_kg, ratio = float(rng.uniform(70.0, 120.0)), float(rng.uniform(1.0, 1.3))
    parameters = ValveParameters(mass_kg, 0.0, F_v, F_c, ratio * F_c, 1.0e-3)
    actuator = Actuator(travel_m=0.25, action=Action.DOUBLE, moving_mass_kg=mass_kg)
    # the level at which half a slow ramp takes it about its travel
    force_n = F_c + 0.25 * F_v * float(rng.uniform(0.25, 0.4))
    return Plant("drive", parameters, Nameplate("BLIND-drive", actuator), -force_n, force_n)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A motion from the record's start at 0 s: every STEPS.output_s the reading, m, and corners of what acted."""

    time_s: FloatArray
    sensed_m: FloatArray
    force_time_s: FloatArray
    force_n: FloatArray

    def sensed_at(self, time_s: FloatArray) -> FloatArray:
        """Clean reading at these times, m."""
        return np.interp(time_s, self.time_s, self.sensed_m)

    def force_at(self, time_s: FloatArray) -> FloatArray:
        """Actuator force at these times, N."""
        return np.interp(time_s, self.force_time_s, self.force_n)


def reached(course: Course) -> tuple[float, float]:
    """The lowest place that a stem comes to after it left its first one, and the highest, m."""
    low_m, high_m = float(course.sensed_m.min()), float(course.sensed_m.max())
    left = int(np.argmax(course.sensed_m >= 0.5 * (low_m + high_m)))
    return float(course.sensed_m[left:].min()), high_m


def comes_back(course: Course) -> bool:
    """Whether a stem that moves goes both ways, each by a tenth of all it sweeps: else friction holds it for good."""
    sensed_m = course.sensed_m
    back_m = float((np.maximum.accumulate(sensed_m) - sensed_m).max())
    out_m = float((sensed_m - np.minimum.accumulate(sensed_m)).max())
    return min(back_m, out_m) >= _BOTH_WAYS * float(np.ptp(sensed_m))


def acting_force(path: InputPath, wave: Waveform, area_m2: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the actuator force from SETTLING_S before the record, on the integration's clock.

    T F' = (1 - leak) min(gain u(t - dead_time), limit) - F, answered exactly for an input that is straight between
    grid points.
    """
    if path.is_neutral:
        time_s = np.concatenate([[0.0], SETTLING_S + wave.time_s])
        level = np.concatenate([wave.pressure_pa[:1], wave.pressure_pa])
        return time_s, np.asarray(area_m2 * level)
    end_s = SETTLING_S + wave.duration_s
    grid_s: FloatArray = np.arange(math.ceil(end_s / PATH_STEP_S) + 1, dtype=np.float64) * PATH_STEP_S
    asked_n = area_m2 * wave.at(np.maximum(grid_s - SETTLING_S - path.dead_time_s, 0.0))
    target_n = (1.0 - path.leak) * np.minimum(path.gain * asked_n, path.limit_n)
    if path.lag_s == 0.0:
        return grid_s, np.asarray(target_n)
    left = math.exp(-PATH_STEP_S / path.lag_s)
    mean = (1.0 - left) * path.lag_s / PATH_STEP_S
    rise = target_n - target_n[0]
    answered = lfilter([1.0 - mean, mean - left], [1.0, -left], rise)
    return grid_s, np.asarray(target_n[0] + answered)


def followed(valve: ExtendedValve, wave: Waveform, area_m2: float, steps: Steps = STEPS) -> Course:
    """The extended valve's motion under a command; drift and vibration count from the record's start."""
    corners = acting_force(valve.input, wave, area_m2)
    duration_s = SETTLING_S + wave.duration_s
    made = replace(on_the_integrations_clock(valve), input=InputPath())
    _position_m, sensed_m = integrate(made, *corners, duration_s, steps.output_s, steps.step_s)
    return _course(sensed_m, corners, steps)


def followed_oddly(
    parameters: ValveParameters, oddity: Oddity, wave: Waveform, area_m2: float, steps: Steps = STEPS
) -> Course:
    """A Karnopp valve's motion under a command, with an oddity."""
    corners = acting_force(InputPath(), wave, area_m2)
    position_m = oddity.position_m(parameters, corners, SETTLING_S + wave.duration_s, steps)
    course = _course(position_m, corners, steps)
    return replace(course, sensed_m=oddity.sensed_m(course.time_s, course.sensed_m))


def _course(sensed_m: FloatArray, corners: tuple[FloatArray, FloatArray], steps: Steps) -> Course:
    first = round(SETTLING_S / steps.output_s)
    shown_m = sensed_m[first:]
    time_s: FloatArray = np.arange(shown_m.size, dtype=np.float64) * steps.output_s
    return Course(time_s, shown_m, corners[0] - SETTLING_S, corners[1])


def on_the_integrations_clock(valve: ExtendedValve) -> ExtendedValve:
    """The valve whose drift and vibration are at the record's start what they are meant to be, SETTLING_S late."""
    slots, p, shaking = valve.friction, valve.parameters, valve.vibration
    grown = math.exp(SETTLING_S / slots.drift_time_s) if slots.drift_n != 0.0 else 1.0
    # change' (1 - exp(-(t + s)/T)) - change' (1 - exp(-s/T)) is change (1 - exp(-t/T)) with change' = change exp(s/T)
    before_n = slots.drift_n * (grown - 1.0)
    levels = replace(
        p,
        coulomb_friction_n=p.coulomb_friction_n - before_n,
        static_friction_n=p.static_friction_n - slots.static_share * before_n,
    )
    phase_rad = math.remainder(shaking.phase_rad - math.tau * shaking.frequency_hz * SETTLING_S, math.tau)
    return replace(
        valve,
        parameters=levels,
        friction=replace(slots, drift_n=slots.drift_n * grown),
        vibration=replace(shaking, phase_rad=phase_rad),
    )
