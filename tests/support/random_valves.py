"""Random valves under random tests, as an estimator may meet them: everything from one explicit seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simulator.transducer import lagged, value_at
from valve.errors import MotionError
from valve.motion import StemState, simulate_motion
from valve.nameplate import Actuator, Nameplate, Signal
from valve.parameters import TravelStops, ValveParameters
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import FloatArray, Waveform, multi_rate_triangle, sine, triangle

# What makes a test hard, with its share of the draws. All kinds vary in everything else too.
KINDS: Final[dict[str, float]] = {
    "captured": 0.16,  # 1 ms, triangle of one rate, pressure known
    "multi_rate": 0.12,  # several ramp rates in a minute
    "polled": 0.15,  # 5 to 50 ms with jitter and a few gaps
    "noisy_pressure": 0.13,  # 0.02 to 0.2 % of the span
    "lagged": 0.06,  # the I/P rounds the corners; its pressure is measured with noise
    "command_only": 0.09,  # as lagged, and the pressure is not measured
    "stops": 0.09,  # travel stops inside the sweep
    "off_balance": 0.08,  # the recording begins in motion, or out of balance
    "sine": 0.06,
    "immobile": 0.06,  # the friction leaves no travel, or less than 2 % of the stroke
}
UNINFORMATIVE: Final = "immobile"  # the kind of which an estimator must not say ok
RANGES_PA: Final = ((0.0, 82737.0), (20.0e3, 100.0e3), (20.7e3, 103.4e3), (40.0e3, 200.0e3), (60.0e3, 300.0e3))
LEAST_MOVED: Final = 0.02  # of the stroke: less makes a valve immobile
_MOST_DRAWS: Final = 200
_CAPTURED_S: Final = 1.0e-3


@dataclass(frozen=True, slots=True, eq=False)
class RandomTest:
    """A recording, what it is of and how it was made.

    ``waveform`` is the command; ``force_time_s`` and ``force_n`` are the corners of the force that acted, on the
    recording's clock. ``noise_m`` holds the sensor's resolution too. ``lag_s`` and ``dead_time_s`` are the I/P's.
    """

    seed: int
    kind: str
    recording: Recording
    nameplate: Nameplate
    truth: ValveParameters
    stops: TravelStops | None
    initial: StemState
    waveform: Waveform
    force_time_s: FloatArray
    force_n: FloatArray
    noise_m: float
    period_s: float
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    delay_s: float = 0.0  # of the pressure channel behind the position


@dataclass(frozen=True, slots=True)
class _Plant:
    truth: ValveParameters
    nameplate: Nameplate
    waveform: Waveform
    moved_m: float  # between the reversals of the slowest ramp, F_v and stops left out


def random_test(seed: int, kind: str | None = None) -> RandomTest:
    """Return the test of this seed, of this kind or of a drawn one; each of a kind differs in all else.

    A draw whose motion needs too many events, or does not move as its kind should, is drawn again.
    """
    rng = np.random.default_rng([2007, seed])
    chosen = str(rng.choice(list(KINDS), p=list(KINDS.values()))) if kind is None else kind
    for _ in range(_MOST_DRAWS):
        try:
            test = _test(seed, chosen, rng)
        except MotionError:
            continue
        still = float(np.nanmax(test.recording.position_m) - np.nanmin(test.recording.position_m))
        moved = (still - 6.0 * test.noise_m) / test.nameplate.actuator.travel_m
        if (moved < LEAST_MOVED) == (chosen == UNINFORMATIVE):
            return test
    raise RuntimeError(f"seed {seed}: no {chosen} test in {_MOST_DRAWS} draws")


def _test(seed: int, kind: str, rng: np.random.Generator) -> RandomTest:
    plant = _plant(kind, rng)
    area_m2 = plant.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    lag_s, dead_time_s = 0.0, 0.0
    if kind in ("lagged", "command_only"):
        lag_s = _log(rng, 0.02, 1.0)
        dead_time_s = float(rng.uniform(0.0, 0.3)) if kind == "command_only" else 0.0
    pressure_s, pressure_pa = _pressure(plant, lag_s, dead_time_s)
    force_n = area_m2 * pressure_pa
    period_s, time_s = _times(kind, plant.waveform.duration_s, rng)
    stops = _stops(plant, rng) if kind == "stops" else None
    state = _start(kind, plant.truth, float(force_n[0]), stops, rng)
    if kind == "off_balance" and rng.random() < 0.5:
        begun_s = float(rng.uniform(0.05, 0.2)) * plant.waveform.duration_s
        time_s = time_s[time_s >= begun_s]
    motion = simulate_motion(plant.truth, pressure_s, force_n, time_s, stops=stops, initial=state)
    first = StemState(float(motion.position_m[0]), float(motion.velocity_m_per_s[0]))
    stroke_m = plant.nameplate.actuator.travel_m
    noise_m = float(np.clip(stroke_m * _log(rng, 1.0e-5, 1.0e-3), 1.0e-6, 100.0e-6))
    position_m = motion.position_m + noise_m * rng.standard_normal(time_s.size)
    if rng.random() < 0.3:  # a 16-bit sensor, a little wider than the stroke
        step_m = 1.2 * stroke_m / 65535
        position_m, noise_m = np.round(position_m / step_m) * step_m, math.hypot(noise_m, step_m / math.sqrt(12.0))
    provenance, delay_s = _provenance(kind, period_s, rng)
    seen_pa = value_at(pressure_s, pressure_pa, time_s - delay_s)
    recording = _recording(kind, plant, time_s, position_m, seen_pa, provenance=provenance, rng=rng)
    return RandomTest(
        seed, kind, recording, plant.nameplate, plant.truth, stops, first, plant.waveform, pressure_s, force_n,
        noise_m, period_s, lag_s, dead_time_s, delay_s,
    )  # fmt: skip


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _waveform(kind: str, low_pa: float, high_pa: float, rng: np.random.Generator) -> tuple[Waveform, float]:
    """Return the command, after a hold that puts its corners between the samples, and its slowest period, s."""
    period_s = float(rng.uniform(12.0, 30.0))
    several = kind == "multi_rate" or (kind not in ("captured", "polled", "sine") and rng.random() < 0.3)
    if several and rng.random() < 0.5:
        fast_s = float(rng.uniform(1.5, 4.0))
        wave = multi_rate_triangle([period_s, *[fast_s] * int(36.0 / fast_s)], low_pa, high_pa)
    elif several:
        wave = multi_rate_triangle((period_s * np.array((1.0, 0.6, 0.4, 0.3, 0.2, 0.1, 0.1))).tolist(), low_pa, high_pa)
    elif kind == "sine":
        wave = sine(period_s, math.floor(66.0 / period_s), low_pa, high_pa)
    else:
        wave = triangle(period_s, math.floor(66.0 / period_s), low_pa, high_pa)
    hold_s = float(rng.uniform(0.1, 1.1))
    time_s = np.concatenate([[0.0], hold_s + wave.time_s])
    return Waveform(wave.name, time_s, np.concatenate([wave.pressure_pa[:1], wave.pressure_pa])), period_s


def _plant(kind: str, rng: np.random.Generator) -> _Plant:
    """Draw the valve, with a spring whose range is about the signal's, and its test."""
    range_pa = RANGES_PA[int(rng.integers(len(RANGES_PA)))]
    inset_pa = float(rng.uniform(0.0, 0.1)) * (range_pa[1] - range_pa[0])
    low_pa, high_pa = range_pa[0] + inset_pa, range_pa[1] - inset_pa
    wave, slowest_s = _waveform(kind, low_pa, high_pa, rng)
    stroke_m, area_m2 = _log(rng, 0.010, 0.120), _log(rng, 0.01, 0.2)
    span_n, middle_n = area_m2 * (high_pa - low_pa), area_m2 * (high_pa + low_pa) / 2.0
    ratio = 1.0 if rng.random() < 0.2 else float(rng.uniform(1.0, 1.8))
    # at F_c + F_s of the whole span the stem does not come back
    share = float(rng.uniform(0.45, 0.8)) if kind == UNINFORMATIVE else _log(rng, 1.0e-3, 0.97 / (1.0 + ratio))
    F_c, F_s = share * span_n, ratio * share * span_n
    free = max(0.0, 1.0 - share * (1.0 + ratio))
    k = float(rng.uniform(max(0.7, 1.02 * free), 1.4)) * span_n / stroke_m
    m = _log(rng, 0.3, 30.0)
    F_v = min(_log(rng, 0.02, 20.0) * 2.0 * math.sqrt(k * m), 0.05 * slowest_s * k)
    ramp_m_per_s = span_n / k / (slowest_s / 2.0)
    F_0 = middle_n - k * stroke_m * float(rng.uniform(0.45, 0.55))
    truth = ValveParameters(m, k, F_v, F_c, F_s, _log(rng, 0.003, 0.05) * ramp_m_per_s, F_0)
    off, known = rng.uniform(0.9, 1.1, 2), rng.random(2) < 0.5
    bench_pa = (max(0.0, F_0 / area_m2) * off[0], max(0.0, F_0 / area_m2) * off[0] + k * stroke_m / area_m2 * off[1])
    actuator = Actuator(
        travel_m=stroke_m,
        diaphragm_area_m2=area_m2,
        moving_mass_kg=m * float(rng.uniform(0.6, 1.4)) if known[0] else None,
        bench_set_pa=bench_pa if known[1] else None,
    )
    nameplate = Nameplate(f"RANDOM-{kind}"[:64], actuator, Signal((4.0, 20.0), range_pa))
    return _Plant(truth, nameplate, wave, free * span_n / k)


def _pressure(plant: _Plant, lag_s: float, dead_time_s: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the pressure at the actuator: the command, dead time and first-order lag behind it."""
    time_s, command_pa = plant.waveform.time_s, plant.waveform.pressure_pa
    if lag_s == 0.0 and dead_time_s == 0.0:
        return time_s, command_pa
    late_s = np.concatenate([[0.0], time_s[1:] + dead_time_s])
    return lagged(late_s, command_pa, float(command_pa[0]), lag_s)


def _stops(plant: _Plant, rng: np.random.Generator) -> TravelStops:
    """Stops that cut 5 to 30 % off the sweep at one end or at both."""
    area_m2 = plant.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    low_pa, high_pa = plant.waveform.range_pa
    truth = plant.truth
    low_m = (area_m2 * low_pa - truth.preload_n + truth.coulomb_friction_n) / truth.spring_rate_n_per_m
    high_m = (area_m2 * high_pa - truth.preload_n - truth.coulomb_friction_n) / truth.spring_rate_n_per_m
    cut_m = rng.uniform(0.05, 0.3, 2) * (high_m - low_m)
    ends = int(rng.integers(3))
    stop_low_m, stop_high_m = float(low_m + cut_m[0]), float(high_m - cut_m[1])
    return TravelStops(stop_low_m if ends != 1 else -math.inf, stop_high_m if ends != 0 else math.inf)


def _start(
    kind: str, truth: ValveParameters, force_n: float, stops: TravelStops | None, rng: np.random.Generator
) -> StemState:
    """At rest somewhere in the stuck band; out of balance by up to 3 F_s and moving for ``off_balance``."""
    most = 3.0 if kind == "off_balance" else 0.95
    net_n = float(rng.uniform(-most, most)) * truth.static_friction_n
    position_m = (force_n - truth.preload_n - net_n) / truth.spring_rate_n_per_m
    if stops is not None:
        position_m = min(max(position_m, stops.low_m), stops.high_m)
    return StemState(position_m)


def _times(kind: str, duration_s: float, rng: np.random.Generator) -> tuple[float, FloatArray]:
    """Return the period and the times of the samples, s: 1 ms by the device's clock, or polled with jitter."""
    polled = kind == "polled" or (kind != "captured" and rng.random() < 0.4)
    period_s = float(rng.choice((5.0e-3, 10.0e-3, 20.0e-3, 50.0e-3))) if polled else _CAPTURED_S
    time_s = np.arange(math.floor(duration_s / period_s) + 1, dtype=np.float64) * period_s
    if polled:
        time_s[1:] += np.clip(rng.normal(0.0, 0.1, time_s.size - 1), -0.4, 0.4) * period_s
    return period_s, time_s


def _provenance(kind: str, period_s: float, rng: np.random.Generator) -> tuple[Provenance, float]:
    """Return how the samples were taken, and how far the pressure was read behind the position, s.

    Captured: both at once. Polled: within the exchange that the recording tells. A file that says nothing: either.
    """
    if kind in ("multi_rate", "noisy_pressure") and rng.random() < 0.3:
        return Provenance(), float(rng.uniform(-0.3, 0.3)) * period_s
    if period_s == _CAPTURED_S:
        return Provenance(Acquisition.CAPTURED, requested_period_s=period_s), 0.0
    uncertainty_s = _log(rng, 0.01, 0.2) * period_s
    provenance = Provenance(Acquisition.POLLED, requested_period_s=period_s, timing_uncertainty_s=uncertainty_s)
    return provenance, float(rng.uniform(-uncertainty_s, uncertainty_s)) if kind != "command_only" else 0.0


def _recording(
    kind: str,
    plant: _Plant,
    time_s: FloatArray,
    position_m: FloatArray,
    pressure_pa: FloatArray,
    *,
    provenance: Provenance,
    rng: np.random.Generator,
) -> Recording:
    """Return what is written down: measured pressure or the command; polled ones with a few gaps."""
    low_pa, high_pa = plant.waveform.range_pa
    if kind in ("noisy_pressure", "lagged"):
        noise_pa = _log(rng, 2.0e-4, 2.0e-3) * (high_pa - low_pa)
        pressure_pa = pressure_pa + noise_pa * rng.standard_normal(time_s.size)
    channel_pa = plant.waveform.at(time_s) if kind == "command_only" else pressure_pa
    missing = np.zeros(time_s.size, dtype=bool)
    if provenance.acquisition is Acquisition.POLLED:
        for first in rng.integers(10, time_s.size - 30, int(rng.integers(0, 5))):
            missing[first : first + int(rng.integers(1, 12))] = True
    gone = missing & bool(rng.random() < 0.5)  # either rows are missing, or they are there and empty
    position_m, channel_pa = np.where(missing, np.nan, position_m), np.where(missing, np.nan, channel_pa)
    recording = Recording(time_s, position_m, pressure_pa=channel_pa, provenance=provenance)
    if kind == "command_only":
        recording = replace(recording, pressure_pa=None, command_pa=channel_pa)
    return recording.rows(~gone)
