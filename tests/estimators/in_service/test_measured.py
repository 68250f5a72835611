"""The measured hour of DAMADICS: a feed water valve that follows its positioner without a rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from estimators.in_service.result import Scale
from estimators.in_service.watch import watched
from valve.recording import Recording

FILE = Path(__file__).parents[4] / "shared" / "data" / "damadics" / "OneHourTestData_ExampleII.mat"


@pytest.mark.skipif(not FILE.exists(), reason="the measured hour of DAMADICS is not beside the project")
def test_a_valve_that_never_rests_has_travel_and_lag_and_says_why_friction_is_not_known() -> None:
    # rows of the matrix: time, ..., controller output in %, rod displacement in %, ...
    matrix = np.asarray(loadmat(FILE)["OneHourTestData_ExampleII"], dtype=np.float64)
    recording = Recording(matrix[0], matrix[6] / 100.0, command_pa=1.0e3 * matrix[5])
    found = watched(recording, None, Scale(is_share=True, command_percent_pa=1.0e3), subject="DAMADICS")
    lag = found.figures["stem_lag"]
    assert lag.value == pytest.approx(1.2, abs=0.3)
    assert found.travel.total == pytest.approx(float(np.abs(np.diff(matrix[6])).sum()) / 100.0, rel=0.02)
    assert found.travel.lowest == pytest.approx(0.487)
    assert found.travel.cycles > 1000
    for name in ("friction", "friction_percent", "dead_band", "stick_band"):
        assert found.figures[name].value is None
        assert "never came to rest" in found.figures[name].note
