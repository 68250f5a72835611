from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.analysis.analysis import analyze_recordings
from service.analysis.driven_force import NOTE
from tests.discrepancy.test_force_diagnosis import drive
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import Recording

AREA_M2 = 0.002
PLATE = Nameplate("DA-1", Actuator(travel_m=0.25, diaphragm_area_m2=AREA_M2, action=Action.DOUBLE))


def by_pressure(recording: Recording, offset_pa: float = 0.0) -> Recording:
    assert recording.force_n is not None
    return replace(recording, force_n=None, pressure_pa=recording.force_n / AREA_M2 + offset_pa)


def test_the_difference_of_both_chambers_pressures_tells_a_double_acting_drive_as_its_force_does() -> None:
    forced = drive(3, asymmetry=-0.18)
    told = analyze_recordings([by_pressure(forced)], PLATE)
    expected = analyze_recordings([forced], PLATE)
    for ours, theirs in zip(told["estimates"], expected["estimates"], strict=True):
        assert ours["status"] == theirs["status"]
        for name, one in ours["parameters"].items():
            value = theirs["parameters"][name]["value"]
            assert one["value"] == (None if value is None else pytest.approx(value, rel=1e-6)), name
    found = told["discrepancy"]
    assert [one["cause"] for one in found["causes"]] == ["friction_asymmetry"]
    assert NOTE in told["notes"]
    assert told["recording"]["channels"] == ["pressure_pa", "position_m"]


def test_one_chambers_pressure_gives_no_parameter() -> None:
    plain = by_pressure(drive(3), 3.0e5)
    assert plain.pressure_pa is not None
    assert np.all(plain.pressure_pa > 0.0)
    told = analyze_recordings([plain], PLATE)
    for estimate in told["estimates"]:
        assert estimate["status"] == "failed"
        assert "both chambers" in estimate["message"]
    assert told["discrepancy"]["verdict"] == "not_assessed"
    assert "both chambers" in told["discrepancy"]["message"]
    assert NOTE not in told["notes"]
