"""Recordings of published valves on the exact motion, for the estimators' tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valve.motion import simulate_motion
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops, ValveParameters, parameters_from_symbols
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import FloatArray, Waveform, triangle

PAPER_VALVES = ("vendor", "nominal", "rough")
VALVES = (*PAPER_VALVES, "graphite")
SYMBOLS = ("m", "k", "F_v", "F_c", "F_s", "DV", "F_0")


@dataclass(frozen=True)
class Recorded:
    """A recording with the valve that it is of."""

    recording: Recording
    nameplate: Nameplate
    truth: ValveParameters


def paper_triangle(name: str, cycles: int = 3) -> Waveform:
    """20 s triangle over the valve's signal range."""
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    return triangle(20.0, cycles, *signal.range_pa)


def recorded(
    name: str,
    *,
    period_s: float = 1.0e-3,
    noise_m: float = 0.0,
    seed: int = 1,
    waveform: Waveform | None = None,
    stops: TravelStops | None = None,
    jitter: float = 0.0,
    resolution_m: float = 0.0,
    preload_n: float = 0.0,
) -> Recorded:
    """Record this valve under the paper's triangle, or another waveform; ``jitter`` is a share of the period."""
    chosen = parameter_set(name)
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    wave = paper_triangle(name) if waveform is None else waveform
    truth = with_preload(chosen.parameters, preload_n)
    random = np.random.default_rng(seed)
    time_s = np.arange(round(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    if jitter > 0.0:
        time_s[1:-1] += np.clip(random.normal(0.0, jitter, time_s.size - 2), -0.4, 0.4) * period_s
    position_m = followed(truth, wave, area_m2, time_s, stops)
    if noise_m > 0.0:
        position_m = position_m + noise_m * random.standard_normal(position_m.size)
    if resolution_m > 0.0:
        position_m = np.round(position_m / resolution_m) * resolution_m
    recording = Recording(time_s=time_s, position_m=position_m, pressure_pa=wave.at(time_s))
    return Recorded(recording, chosen.nameplate, truth)


def with_preload(parameters: ValveParameters, more_n: float) -> ValveParameters:
    """The same valve with a preload that is higher by this much."""
    values = parameters.by_symbol()
    values["F_0"] += more_n
    return ValveParameters(*values.values())


def followed(
    truth: ValveParameters, wave: Waveform, area_m2: float, time_s: FloatArray, stops: TravelStops | None
) -> FloatArray:
    """Exact position at these times, m."""
    return simulate_motion(truth, wave.time_s, area_m2 * wave.pressure_pa, time_s, stops=stops).position_m


def stroked(symbols: dict[str, float], *, noise_m: float, period_s: float = 1.0e-2, cycles: int = 2) -> Recorded:
    """Record a valve of these parameters, in SI, in the place of the nominal one; F_0 is 0. 20 s a cycle."""
    chosen = parameter_set("nominal")
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    truth = parameters_from_symbols({**symbols, "F_0": 0.0})
    time_s = np.arange(round(20.0 * cycles / period_s), dtype=np.float64) * period_s
    wave = triangle(20.0, cycles, *signal.range_pa)
    noise = noise_m * np.random.default_rng(1).standard_normal(time_s.size)
    position_m = followed(truth, wave, area_m2, time_s, None) + noise
    at_once = Provenance(Acquisition.CAPTURED, requested_period_s=period_s)
    recording = Recording(time_s, position_m, pressure_pa=wave.at(time_s), provenance=at_once)
    return Recorded(recording, chosen.nameplate, truth)
