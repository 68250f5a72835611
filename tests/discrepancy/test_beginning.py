"""Where the stem is when a recording begins."""

from __future__ import annotations

import numpy as np
import pytest

from discrepancy.observed import Observed, observe
from tests.blind.cases import blind_case
from tests.discrepancy.hidden import hidden


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
