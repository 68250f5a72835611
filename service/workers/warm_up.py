"""Everything that is compiled at first use, used once: the first real analysis then takes no longer than the others."""

from __future__ import annotations

from typing import Final

import numpy as np

from service.analysis.analysis import analyze_recordings
from valve.motion import simulate_waveform
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import triangle

_NOISE_M: Final = 5.0e-6  # a position without noise takes another way


def warm_up() -> None:
    """Analyse a short simulated test."""
    valve = PARAMETER_SETS["nominal"]
    area_m2 = valve.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    waveform = triangle(4.0, 2, 0.0, 82737.0)
    motion = simulate_waveform(valve.parameters, waveform, area_m2, 0.002)
    noise_m = _NOISE_M * np.random.default_rng(0).standard_normal(motion.time_s.size)
    recording = Recording(
        motion.time_s,
        motion.position_m + noise_m,
        pressure_pa=waveform.at(motion.time_s),
        provenance=Provenance(Acquisition.SIMULATED),
    )
    analyze_recordings([recording], valve.nameplate, held_out=[("itself", recording)])
