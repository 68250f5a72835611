"""A pressure recorded from vacuum is told, and no recording with another bench set is called well."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import service.analysis.analysis
from discrepancy.notes.zero_note import zero_doubt
from service.analysis.analysis import analyze_recordings
from tests.support.hidden import AREA_M2, FULL_PA
from valve.nameplate import Actuator, Nameplate, Signal
from valve.recording import Recording

PLATE = Nameplate(
    tag="FV-1",
    actuator=Actuator(travel_m=0.1016, diaphragm_area_m2=AREA_M2, bench_set_pa=(5.0e3, 80.0e3)),
    signal=Signal(range_ma=(4.0, 20.0), range_pa=(0.0, FULL_PA)),
)


def analysed(preload_pa: tuple[float, float], **changed: Any) -> dict[str, Any]:
    preload = {"value": None, "ci95": [AREA_M2 * end for end in preload_pa]}
    estimate = {"method": "maximum_likelihood", "status": "ok", "parameters": {"F_0": preload}} | changed
    return {"recording": {"channels": ["pressure_pa", "position_m"]}, "estimates": [estimate]}


def test_an_atmosphere_too_much_is_told_as_a_pressure_from_vacuum() -> None:
    told = zero_doubt(analysed((106.2e3, 106.4e3)), PLATE)
    assert told.startswith("The bench set begins at 106.3 kPa by this recording and at 5 kPa by the nameplate")
    assert "recorded from vacuum" in told


@pytest.mark.parametrize("preload_pa", [(45.0e3, 46.0e3), (-40.0e3, -39.0e3)])
def test_a_preload_that_no_spring_has_asks_for_zero_and_nameplate(preload_pa: tuple[float, float]) -> None:
    told = zero_doubt(analysed(preload_pa), PLATE)
    assert "check the zero" in told
    assert "vacuum" not in told


def test_nothing_is_doubted_that_a_spring_or_a_wide_interval_explains() -> None:
    assert zero_doubt(analysed((20.0e3, 21.0e3)), PLATE) == "", "spring_preload names it"
    assert zero_doubt(analysed((20.0e3, 90.0e3)), PLATE) == "", "it may be a spring's"
    assert zero_doubt(analysed((106.2e3, 106.4e3), status="poor"), PLATE) == ""
    unknown = replace(PLATE, actuator=replace(PLATE.actuator, bench_set_pa=None))
    assert zero_doubt(analysed((106.2e3, 106.4e3)), unknown) == ""
    command = analysed((106.2e3, 106.4e3)) | {"recording": {"channels": ["command_pa", "position_m"]}}
    assert zero_doubt(command, PLATE) == ""


def test_a_recording_from_vacuum_is_not_assessed_and_a_named_cause_keeps_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What estimates and diagnosis would say is given: what is tried is what the analysis object makes of both."""
    of_vacuum, verdict = analysed((106.2e3, 106.4e3)), "none"
    estimates = [SimpleNamespace(to_json=lambda: of_vacuum["estimates"][0])]
    for name, value in {
        "read_motion": None,
        "estimate_all": estimates,
        "signature": {},
        "recording_summary": of_vacuum["recording"],
    }.items():
        monkeypatch.setattr(service.analysis.analysis, name, lambda *_args, value=value: value)
    monkeypatch.setattr(
        service.analysis.analysis, "assess", lambda *_args, **_kwargs: {"verdict": verdict, "message": "", "causes": []}
    )
    row = np.arange(10.0)
    recording = Recording(row, row, pressure_pa=row)
    alone = analyze_recordings([recording], PLATE)
    assert alone["discrepancy"]["verdict"] == "not_assessed"
    assert "recorded from vacuum" in alone["discrepancy"]["message"]
    assert alone["notes"] == []
    verdict = "named"
    beside = analyze_recordings([recording], PLATE)
    assert beside["discrepancy"]["verdict"] == "named"
    assert "recorded from vacuum" in beside["notes"][0]
