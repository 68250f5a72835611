"""A healthy polled valve: what the instants of writes and looks leave unknown is no effect of the valve."""

from __future__ import annotations

import pytest

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Verdict
from discrepancy.observed import Observed, observe
from tests.estimators.likelihood.polled_recordings import written_test

pytestmark = pytest.mark.long


@pytest.mark.parametrize("valve", ["nominal", "rough"])
def test_a_healthy_polled_valve_is_never_called_unexplained_or_given_a_cause(valve: str) -> None:
    test = written_test(valve, seed=2)
    diagnosis = diagnose([test.recording], test.nameplate)
    assert diagnosis.verdict in (Verdict.NONE, Verdict.NOT_ASSESSED), diagnosis.message
    assert diagnosis.before is not None
    if diagnosis.verdict is Verdict.NOT_ASSESSED:
        assert "times the sensor's noise" in diagnosis.message
        assert "captured" in diagnosis.message


def test_behind_a_lag_late_looks_spoil_their_own_rows_alone_and_the_stem_can_be_judged() -> None:
    rounded = written_test("nominal", seed=2, lag_s=0.1, pressure_noise_pa=20.0)
    stepped = written_test("nominal", seed=2)
    doubts = []
    for test in (rounded, stepped):
        observed = observe([test.recording], test.nameplate)
        assert isinstance(observed, Observed)
        doubts.append(observed.doubt_in_noises)
    assert doubts[0] < 1.5
    assert doubts[1] > 5.0
    diagnosis = diagnose([rounded.recording], rounded.nameplate)
    assert [finding.cause for finding in diagnosis.causes] == ["transducer_lag"], diagnosis.message
