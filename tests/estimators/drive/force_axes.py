"""Axes without a spring under a position controller, on the exact motion: what a force recording is of."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.signal import lfilter

from valve.motion import StemIntegrator, StemState
from valve.nameplate import Action, Actuator, Nameplate
from valve.parameters import ValveParameters
from valve.recording import FloatArray, Recording

NAMEPLATE = Nameplate("axis", Actuator(travel_m=0.5, action=Action.DOUBLE))


class Reference(StrEnum):
    """What the controller follows."""

    SINE = "sine"
    MULTI_SINE = "multi-sine"
    TRAPEZOID = "trapezoid"


@dataclass(frozen=True)
class Axis:
    """A recording with the axis that it is of."""

    recording: Recording
    truth: ValveParameters
    noise_m: float

    def value(self, symbol: str) -> float:
        return self.truth.by_symbol()[symbol]


def random_axis(
    seed: int,
    *,
    reference: Reference | None = None,
    noise_m: float | None = None,
    force_noise: float | None = None,
    correlation: float | None = None,
    duration_s: float = 12.0,
    period_s: float = 1.0e-3,
) -> Axis:
    """Draw an axis of 1 to 200 kg; ``force_noise`` is a share of F_c, ``correlation`` that of neighbouring errors.

    The controller sees the noisy position. Its force goes straight from sample to sample, and is recorded with errors.
    """
    random = np.random.default_rng(seed)
    chosen = reference or Reference(random.choice([str(kind) for kind in Reference]))
    mass, amplitude_m = float(np.exp(random.uniform(0.0, np.log(200.0)))), random.uniform(0.05, 0.3)
    usual_speed = 1.5 * amplitude_m
    coulomb = float(20.0 * mass * amplitude_m * np.exp(random.uniform(np.log(0.03), 0.0)))
    viscous = float(coulomb / usual_speed * np.exp(random.uniform(np.log(0.1), np.log(2.0))))
    static, preload = coulomb * random.uniform(1.0, 1.4), random.uniform(-0.3, 0.3) * coulomb
    truth = ValveParameters(mass, 0.0, viscous, coulomb, static, 1.0e-4 * amplitude_m, preload)
    drawn = float(np.exp(random.uniform(np.log(1.0e-7), np.log(1.0e-4)))), float(np.exp(random.uniform(-5.8, -2.3)))
    noise_m = drawn[0] if noise_m is None else noise_m
    error_n = coulomb * (drawn[1] if force_noise is None else force_noise)
    correlation = float(random.choice([0.0, 0.9])) if correlation is None else correlation
    time_s = np.arange(round(duration_s / period_s) + 1, dtype=np.float64) * period_s
    wanted_m = _reference(chosen, time_s, random, amplitude_m)
    noise = noise_m * random.standard_normal(time_s.size)
    loop_rad_per_s = 2.0 * np.pi * random.uniform(3.0, 8.0)
    position_m, force_n = _controlled(
        truth, time_s, wanted_m, noise, loop_rad_per_s=loop_rad_per_s, turning_speed=0.02 * usual_speed
    )
    white = error_n * np.sqrt(1.0 - correlation**2) * random.standard_normal(time_s.size)
    force_n = force_n + lfilter([1.0], [1.0, -correlation], white)
    return Axis(Recording(time_s=time_s, position_m=position_m + noise, force_n=force_n), truth, noise_m)


def _controlled(
    truth: ValveParameters,
    time_s: FloatArray,
    wanted_m: FloatArray,
    noise_m: FloatArray,
    *,
    loop_rad_per_s: float,
    turning_speed: float,
) -> tuple[FloatArray, FloatArray]:
    """Position (m) and force (N) under proportional, derivative and feed-forward control, one sample late."""
    period_s = float(time_s[1] - time_s[0])
    stiffness, damping = truth.mass_kg * loop_rad_per_s**2, 1.4 * truth.mass_kg * loop_rad_per_s
    speed = np.gradient(wanted_m, period_s)
    forward = truth.preload_n + truth.coulomb_friction_n * np.tanh(speed / turning_speed)
    forward += truth.viscous_friction_n_s_per_m * speed
    stem, state, corner = StemIntegrator(truth), StemState(float(wanted_m[0])), np.array((0.0, period_s))
    position_m, force_n = np.empty(time_s.size), np.empty(time_s.size)
    force, seen_speed, last_m = truth.preload_n, 0.0, state.position_m + float(noise_m[0])
    for row in range(time_s.size):
        position_m[row], force_n[row] = state.position_m, force
        seen_m = state.position_m + float(noise_m[row])
        seen_speed += 0.2 * ((seen_m - last_m) / period_s - seen_speed)
        last_m = seen_m
        asked = stiffness * (wanted_m[row] - seen_m) + damping * (speed[row] - seen_speed) + forward[row]
        state = stem.advance(state, corner, np.array((force, asked)))
        force = float(asked)
    return position_m, force_n


def _reference(kind: Reference, time_s: FloatArray, random: np.random.Generator, amplitude_m: float) -> FloatArray:
    if kind is Reference.SINE:
        return np.asarray(0.5 * amplitude_m * (1.0 - np.cos(2.0 * np.pi * time_s / random.uniform(1.0, 4.0))))
    if kind is Reference.MULTI_SINE:
        base_hz, sum_m = random.uniform(0.15, 0.5), np.zeros(time_s.size)
        for harmonic, share in ((1, 1.0), (2, 0.45), (3, 0.3), (5, 0.15)):
            sum_m += share * np.sin(2.0 * np.pi * base_hz * harmonic * time_s + random.uniform(0.0, 6.28))
        return np.asarray(amplitude_m * sum_m / np.ptp(sum_m))
    speeds = amplitude_m * np.array([0.4, 0.8, 1.4]) * random.uniform(0.7, 1.3)
    return _trapezoids(time_s, amplitude_m, speeds, random)


def _trapezoids(time_s: FloatArray, amplitude_m: float, speeds: FloatArray, random: np.random.Generator) -> FloatArray:
    """To and fro at several speeds, with a rest of 0.2 s at every third end or so."""
    period_s, rate = float(time_s[1] - time_s[0]), random.uniform(5.0, 12.0) * amplitude_m
    wanted_m, place_m, speed, goal_m, stroke, rest = np.empty(time_s.size), 0.0, 0.0, amplitude_m, 0, 0
    for row in range(time_s.size):
        way_m = goal_m - place_m
        if rest > 0:
            rest, speed = rest - 1, 0.0
        else:
            limit = min(float(speeds[stroke % speeds.size]), float(np.sqrt(2.0 * rate * abs(way_m))))
            speed += float(np.clip(np.sign(way_m) * limit - speed, -rate * period_s, rate * period_s))
            if abs(way_m) < 1.0e-4 * amplitude_m + abs(speed) * period_s:
                place_m, speed, goal_m, stroke = goal_m, 0.0, amplitude_m - goal_m, stroke + 1
                rest = int(random.choice([0, 0, round(0.2 / period_s)]))
        place_m += speed * period_s
        wanted_m[row] = place_m
    return wanted_m
