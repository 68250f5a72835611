"""Recordings of a simulated valve as loggers make them, for the tests of the data's faults."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from valve.motion import simulate_waveform
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import FloatArray, Recording
from valve.waveform import Waveform, sine, steps, triangle

FULL_PA: Final = 82737.0
PLATE: Final = PARAMETER_SETS["nominal"].nameplate
WAVES: Final[dict[str, Waveform]] = {
    "triangle": triangle(10.0, 6, 0.0, FULL_PA),
    "fast": triangle(4.0, 5, 0.0, FULL_PA),
    "slow": triangle(60.0, 1, 0.0, FULL_PA),
    "sine": sine(8.0, 3.0, 0.0, FULL_PA),
    "pulse": steps([0.0, 7.0e4, 0.0], 6.0),
    "pulses": steps([2.0e4, 7.0e4, 2.0e4, 7.0e4, 2.0e4], 0.8),
    "steps": steps([0.0, 2.0e4, 4.0e4, 6.0e4, 8.0e4, 6.0e4, 4.0e4, 2.0e4, 0.0], 5.0),
}


@lru_cache(maxsize=32)
def _moved(valve: str, wave: str) -> tuple[FloatArray, FloatArray]:
    chosen = PARAMETER_SETS[valve]
    area_m2 = chosen.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    motion = simulate_waveform(chosen.parameters, WAVES[wave], area_m2, 0.001)
    return motion.time_s, motion.position_m


def logged(
    period_s: float = 0.01,
    *,
    valve: str = "nominal",
    wave: str = "triangle",
    noise: tuple[float, float] = (1.0e-5, 20.0),
    digits: tuple[float, float] = (0.0, 0.0),
    stops_m: tuple[float, float] | None = None,
    late: float = 0.0,
    lost: float = 0.0,
    seed: int = 1,
) -> Recording:
    """Return position and pressure with white noise (m, Pa) on converters' digits (m, Pa; 0: none).

    ``late``: by this share of the period, rms, each row was asked for later than due, and is stamped so; ``lost``:
    this share of the rows is missing; ``stops_m``: mechanical stops.
    """
    random = np.random.default_rng(seed)
    whole_s, whole_m = _moved(valve, wave)
    time_s = np.arange(0.0, float(whole_s[-1]), period_s)
    if late > 0.0:
        time_s = np.maximum.accumulate(time_s + late * period_s * np.abs(random.normal(size=time_s.size)))
        time_s = time_s[np.concatenate([[True], np.diff(time_s) > 1.0e-6]) & (time_s < whole_s[-1])]
    position_m, pressure_pa = np.interp(time_s, whole_s, whole_m), WAVES[wave].at(time_s)
    if stops_m is not None:
        position_m = np.clip(position_m, *stops_m)
    position_m = position_m + noise[0] * random.normal(size=time_s.size)
    pressure_pa = pressure_pa + noise[1] * random.normal(size=time_s.size)
    if digits[0] > 0.0:
        position_m = np.round(position_m / digits[0]) * digits[0]
    if digits[1] > 0.0:
        pressure_pa = np.round(pressure_pa / digits[1]) * digits[1]
    kept = random.random(time_s.size) >= lost
    return Recording(time_s[kept], position_m[kept], pressure_pa=pressure_pa[kept])
