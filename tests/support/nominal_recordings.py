"""Recordings of a simulated nominal valve for the tests of the analysis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valve.motion import simulate_waveform
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, sine, triangle

NOMINAL = PARAMETER_SETS["nominal"]
NAMEPLATE_TOML = """\
tag = "FV-101"
[actuator]
diaphragm_area_m2 = 0.06452
travel_m = 0.1016
[signal]
range_ma = [4.0, 20.0]
range_pa = [0.0, 82737.0]
"""


def recorded(waveform: Waveform, period_s: float = 0.001, noise_m: float = 0.0) -> Recording:
    """Return the nominal valve's answer to a waveform, pressure known exactly, position with noise (seed 7)."""
    assert NOMINAL.nameplate.actuator.diaphragm_area_m2 is not None
    motion = simulate_waveform(NOMINAL.parameters, waveform, NOMINAL.nameplate.actuator.diaphragm_area_m2, period_s)
    noise = np.random.default_rng(7).normal(0.0, noise_m, motion.time_s.size) if noise_m > 0.0 else 0.0
    return Recording(
        motion.time_s,
        motion.position_m + noise,
        pressure_pa=waveform.at(motion.time_s),
        provenance=Provenance(Acquisition.SIMULATED, tag="FV-101"),
    )


def triangle_test(period_s: float = 0.001, noise_m: float = 0.0) -> Recording:
    """Two cycles of 10 s over the whole signal."""
    return recorded(triangle(10.0, 2, 0.0, 82737.0), period_s, noise_m)


def sine_test(period_s: float = 0.001) -> Recording:
    """One cycle of 8 s: the paper's validation."""
    return recorded(sine(8.0, 1.0, 0.0, 82737.0), period_s)


def with_gaps(recording: Recording) -> Recording:
    """Return the recording with two gaps in its position."""
    position_m = recording.position_m.copy()
    position_m[100:120] = np.nan
    position_m[5000] = np.nan
    return replace(recording, position_m=position_m)


def at_rest() -> Recording:
    """Return a test in which the stem never moves."""
    time_s = np.linspace(0.0, 10.0, 10_001)
    noise_m = np.random.default_rng(3).normal(0.0, 2.0e-6, time_s.size)
    return Recording(time_s, 0.02 + noise_m, pressure_pa=triangle(10.0, 1, 0.0, 5000.0).at(time_s))
