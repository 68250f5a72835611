"""A converter whose steps are wider than the noise: a stem at rest repeats one error, and shows no noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Verdict
from discrepancy.observed import Observed, observe
from discrepancy.row_noise import resting_noise
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from tests.discrepancy.hidden import AREA_M2, FULL_PA, Hidden, hidden, recorded_of
from valve.recording import Recording
from valve.waveform import joined

_STEP_M = 0.1016 / 2**12
_OWN_NOISE_M = 0.02 * _STEP_M
_LEGS = ((0.0, 0.1), (1.0, 0.1), (6.0, 0.9), (4.0, 0.9), (6.0, 0.1), (4.0, 0.1), (6.0, 0.9), (4.0, 0.9))


def _with_rests(noise_m: float = _OWN_NOISE_M, preload_n: float = 0.0) -> tuple[Hidden, Recording]:
    """Three strokes with rests at their ends, the position rounded to steps; a preload that the nameplate lacks."""
    case = hidden("nominal", seed=3)
    wave = joined("with rests", [(run_s, share * FULL_PA) for run_s, share in _LEGS])
    recording = recorded_of(case.valve, wave, 4.0e-3, noise_m, seed=3)
    rounded_m = np.rint(recording.position_m / _STEP_M) * _STEP_M
    assert recording.pressure_pa is not None
    return case, replace(recording, position_m=rounded_m, pressure_pa=recording.pressure_pa + preload_n / AREA_M2)


@pytest.mark.parametrize("own_steps", [0.02, 0.2, 0.4])
def test_the_noise_of_a_rounded_position_is_that_of_its_steps_too(own_steps: float) -> None:
    case, recording = _with_rests(own_steps * _STEP_M)
    motion = read_motion(recording, case.nameplate)
    assert isinstance(motion, RecordedMotion)
    both_m = _STEP_M * math.hypot(1.0 / math.sqrt(12.0), own_steps)
    assert resting_noise(motion) == pytest.approx(both_m, rel=0.25)


def test_a_rest_on_one_step_counts_as_one_row() -> None:
    case, recording = _with_rests()
    observed = observe([recording], case.nameplate)
    assert isinstance(observed, Observed)
    rest = (observed.time_s > 8.5) & (observed.time_s < 10.5)
    assert np.count_nonzero(rest) > 100
    told = float(np.sum(observed.weight[rest] ** 2)) * _STEP_M**2 / 12.0
    assert told < 1.5
    moving = (observed.time_s > 3.0) & (observed.time_s < 6.0)
    assert float(np.median(observed.weight[moving])) > 0.5 * math.sqrt(12.0) / _STEP_M
    # nor is where the stem begins known to better than a step
    assert observed.segments[0].start_error_m > 0.5 * _STEP_M / math.sqrt(12.0)


def test_a_healthy_valve_with_a_coarse_position_has_nothing_beyond_the_noise() -> None:
    case, recording = _with_rests()
    assert diagnose([recording], case.nameplate).verdict is Verdict.NONE


def test_a_preload_is_named_behind_a_coarse_position() -> None:
    preload_n = -100.0
    case, recording = _with_rests(preload_n=preload_n)
    found = diagnose([recording], case.nameplate)
    assert [finding.cause for finding in found.causes] == ["spring_preload"]
    assert found.causes[0].parameters["offset_n"].value == pytest.approx(preload_n, rel=0.1)
