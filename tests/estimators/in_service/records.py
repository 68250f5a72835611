"""Records of a valve in service with an exact truth: quasi-static stick-slip, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valve.nameplate import Actuator, Nameplate, Signal
from valve.recording import FloatArray, Recording

TRAVEL_M = 0.03
AREA_M2 = 0.04
BENCH_PA = (20.0e3, 100.0e3)
FRICTION_PA = 3000.0  # by the area 120 N
BREAKAWAY_PA = 4000.0  # 160 N
SPRING_PA_PER_M = (BENCH_PA[1] - BENCH_PA[0]) / TRAVEL_M
PLATE = Nameplate("FV-7", Actuator(TRAVEL_M, AREA_M2, bench_set_pa=BENCH_PA), Signal((4.0, 20.0), BENCH_PA))


@dataclass(frozen=True, slots=True)
class Noise:
    """What the channels have on top; m and Pa, one standard deviation or the step of a converter."""

    position_m: float = 3.0e-6
    pressure_pa: float = 20.0
    position_step_m: float = 0.0


def wandering_pressure(time_s: FloatArray, seed: int, swing_pa: float = 9.0e3) -> FloatArray:
    """Pressure of a loop: turns at random times and levels, straight between them, shape (n,)."""
    random = np.random.default_rng(seed)
    turns_s = np.cumsum(random.uniform(15.0, 60.0, 1 + int(time_s[-1] / 15.0)))
    levels_pa = 60.0e3 + swing_pa * random.uniform(-1.0, 1.0, turns_s.size)
    return np.asarray(np.interp(time_s, np.concatenate([[0.0], turns_s]), np.concatenate([[60.0e3], levels_pa])))


def stick_slip(pressure_pa: FloatArray, scatter: float, seed: int) -> FloatArray:
    """Position under this pressure, m, shape (n,): stuck up to F_s, then it jumps to where friction is F."""
    random = np.random.default_rng([seed, 1])
    position_m = np.empty(pressure_pa.size)
    at_m = (pressure_pa[0] - BENCH_PA[0]) / SPRING_PA_PER_M
    holds_pa = BREAKAWAY_PA * (1.0 + scatter * random.standard_normal())
    for row, pressure in enumerate(pressure_pa.tolist()):
        left_pa = pressure - BENCH_PA[0] - SPRING_PA_PER_M * at_m
        if abs(left_pa) >= holds_pa:
            at_m += (left_pa - np.sign(left_pa) * FRICTION_PA) / SPRING_PA_PER_M
            holds_pa = BREAKAWAY_PA * (1.0 + scatter * random.standard_normal())
        position_m[row] = at_m
    return position_m


def record(
    hours: float = 1.0,
    period_s: float = 0.1,
    seed: int = 1,
    *,
    scatter: float = 0.02,
    noise: Noise = Noise(),
    swing_pa: float = 9.0e3,
) -> Recording:
    """Return rows every ``period_s`` of a stem that is followed every 20 ms."""
    fine_s = np.arange(0.0, 3600.0 * hours, min(0.02, period_s))
    pressure_pa = wandering_pressure(fine_s, seed, swing_pa)
    position_m = stick_slip(pressure_pa, scatter, seed)
    every = max(1, round(period_s / 0.02))
    random = np.random.default_rng([seed, 2])
    time_s, pressure_pa, position_m = fine_s[::every], pressure_pa[::every], position_m[::every]
    position_m = position_m + noise.position_m * random.standard_normal(time_s.size)
    if noise.position_step_m > 0.0:
        position_m = noise.position_step_m * np.round(position_m / noise.position_step_m)
    return Recording(
        time_s, position_m, pressure_pa=pressure_pa + noise.pressure_pa * random.standard_normal(time_s.size)
    )
