"""A healthy polled valve: what the instants of writes and looks leave unknown is no effect of the valve."""

from __future__ import annotations

import pytest

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Verdict
from tests.estimators.likelihood.polled_recordings import written_test


@pytest.mark.parametrize("valve", ["nominal", "rough"])
def test_a_healthy_polled_valve_is_never_called_unexplained_or_given_a_cause(valve: str) -> None:
    test = written_test(valve, seed=2)
    diagnosis = diagnose([test.recording], test.nameplate)
    assert diagnosis.verdict in (Verdict.NONE, Verdict.NOT_ASSESSED), diagnosis.message
    assert diagnosis.before is not None
    if diagnosis.verdict is Verdict.NOT_ASSESSED:
        assert "times the sensor's noise" in diagnosis.message
        assert "captured" in diagnosis.message
