"""Where the stem is when a recording begins."""

from __future__ import annotations

import numpy as np
import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.observed import Observed, observe
from discrepancy.significance import misfit
from tests.blind.cases import blind_case
from tests.discrepancy.hidden import AREA_M2, FULL_PA, hidden, recorded_of
from valve.waveform import triangle


def test_a_stem_that_creeps_on_its_bristles_begins_at_rest() -> None:
    case = blind_case(7314, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    first = observed.segments[0]
    assert first.start_velocity == 0.0
    before_m = float(np.mean(case.recordings[0].position_m[:200]))
    assert first.start_m == pytest.approx(before_m, abs=5.0e-6)
    assert first.start_error_m < 0.3 * case.noise_m


def test_a_recording_that_begins_in_motion_begins_with_its_velocity() -> None:
    case = hidden("nominal", seed=1)
    recording = case.recording.rows(case.recording.time_s > 4.0)
    observed = observe([recording], case.nameplate)
    assert isinstance(observed, Observed)
    speed = np.polyfit(recording.time_s[:300], recording.position_m[:300], 1)[0]
    assert observed.segments[0].start_velocity == pytest.approx(speed, rel=0.5)


def test_a_stem_let_go_out_of_balance_begins_at_rest_and_needs_no_cause() -> None:
    case = hidden("nominal", seed=1)
    low_pa = 0.4 * FULL_PA
    assert AREA_M2 * low_pa > 1.2 * case.valve.parameters.static_friction_n  # it leaves its end of the travel at once
    recording = recorded_of(case.valve, triangle(8.0, 1, low_pa, FULL_PA), 1.0e-3)
    observed = observe([recording], case.nameplate)
    assert isinstance(observed, Observed)
    windowed = observed.segments[0].start_velocity
    assert windowed > 0.1
    fit = fit_baseline(observed)
    assert fit is not None
    assert abs(fit.values["v_0"]) < 0.1 * windowed
    assert misfit(fit) < 1.1
