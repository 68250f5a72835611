"""Recordings of valves with a hidden effect, by an integration that shares nothing with the kernel that fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.support.extended_reference import integrate
from valve.effects import Effect, with_effects
from valve.extended_valve import ExtendedValve
from valve.nameplate import Actuator, Nameplate, Signal
from valve.parameter_sets import parameter_set
from valve.parameters import parameters_from_symbols
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, sine, triangle

AREA_M2 = 0.06452
FULL_PA = 82737.0
PERIOD_S = 2.0e-3
STEP_S = 1.0e-5


@dataclass(frozen=True)
class Hidden:
    """What the finder sees, a further recording that it does not fit, and the valve behind both."""

    recording: Recording
    held_out: Recording
    nameplate: Nameplate
    valve: ExtendedValve


def hidden(
    name: str,
    *effects: Effect,
    seed: int,
    noise_m: float = 20.0e-6,
    factor: float = 1.0,
    preload_n: float = 200.0,
    cycle_s: float = 12.0,
    period_s: float = PERIOD_S,
) -> Hidden:
    """Record this valve, its spring and friction times ``factor``, with these effects in it; 2 cycles."""
    chosen = parameter_set(name)
    values = chosen.parameters.by_symbol()
    values |= {symbol: factor * values[symbol] for symbol in ("F_v", "F_c", "F_s")}
    values["F_0"] = preload_n
    valve = with_effects(ExtendedValve(parameters_from_symbols(values)), effects)
    rate, travel_m = values["k"], 0.1016
    bench_set_pa = (preload_n / AREA_M2, (preload_n + rate * travel_m) / AREA_M2)
    nameplate = Nameplate(
        tag=name.upper(),
        actuator=Actuator(
            travel_m=travel_m, diaphragm_area_m2=AREA_M2, moving_mass_kg=1.3608, bench_set_pa=bench_set_pa
        ),
        signal=Signal(range_ma=(4.0, 20.0), range_pa=(0.0, FULL_PA)),
    )
    low_pa = preload_n / AREA_M2
    fitted = recorded_of(valve, triangle(cycle_s, 2, low_pa, FULL_PA), period_s, noise_m, seed)
    held_out = recorded_of(valve, sine(8.0, 1, low_pa, 0.9 * FULL_PA), period_s, noise_m, seed + 1000)
    return Hidden(fitted, held_out, nameplate, valve)


def recorded_of(
    valve: ExtendedValve, wave: Waveform, period_s: float = PERIOD_S, noise_m: float = 20.0e-6, seed: int = 0
) -> Recording:
    """Record this valve under a command, by the integration."""
    _stem_m, sensed_m = integrate(valve, wave.time_s, AREA_M2 * wave.pressure_pa, wave.duration_s, period_s, STEP_S)
    time_s = np.arange(sensed_m.size, dtype=np.float64) * period_s
    noise = noise_m * np.random.default_rng(seed).standard_normal(time_s.size)
    return Recording(
        time_s=time_s,
        position_m=sensed_m + noise,
        pressure_pa=wave.at(time_s),
        provenance=Provenance(acquisition=Acquisition.CAPTURED),
    )
