"""The moving mass gives a wrong diaphragm area away, and with the spring rate a wrong range."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from discrepancy.notes.scale_note import scale_note
from service.analysis.analysis import analyze_recordings
from tests.support.hidden import Hidden, hidden
from valve.nameplate import Nameplate
from valve.recording import Recording


@pytest.fixture(scope="module")
def nominal() -> Hidden:
    return hidden("nominal", seed=5)


def of_actuator(nameplate: Nameplate, **changed: Any) -> Nameplate:
    return replace(nameplate, actuator=replace(nameplate.actuator, **changed))


def noted(recording: Recording, nameplate: Nameplate) -> list[str]:
    notes: list[str] = analyze_recordings([recording], nameplate)["notes"]
    return notes


def test_a_right_nameplate_gets_no_note(nominal: Hidden) -> None:
    assert noted(nominal.recording, nominal.nameplate) == []


@pytest.mark.parametrize("factor", [0.5, pytest.param(2.0, marks=pytest.mark.long)])
def test_a_wrong_area_shows_in_the_mass_while_the_spring_rate_agrees(nominal: Hidden, factor: float) -> None:
    area_m2 = nominal.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    wrong = of_actuator(nominal.nameplate, diaphragm_area_m2=factor * area_m2)
    (note,) = noted(nominal.recording, wrong)
    told = re.match(r"The moving mass is \S+ \((\S+) to (\S+)\) times the nameplate's 1.3608 kg", note)
    assert told is not None
    assert float(told[1]) <= factor <= float(told[2])
    assert "the nameplate's mass is wrong, or its diaphragm area" in note, "nobody can tell which"
    assert noted(nominal.recording, of_actuator(wrong, moving_mass_kg=None)) == []
    assert noted(nominal.recording, of_actuator(wrong, bench_set_pa=None)) == []


def test_a_wrong_range_shows_in_mass_and_spring_rate_alike(nominal: Hidden) -> None:
    pressure_pa = nominal.recording.pressure_pa
    assert pressure_pa is not None
    (note,) = noted(replace(nominal.recording, pressure_pa=1.3 * pressure_pa), nominal.nameplate)
    assert note.startswith("Spring rate and moving mass are both 1.3 times")


def analysed(mass_kg: tuple[float, float, float], rate: float, **discrepancy: Any) -> dict[str, Any]:
    low, value, high = mass_kg
    parameters = {"m": {"value": value, "ci95": [low, high]}, "k": {"value": rate, "ci95": None}}
    return {
        "recording": {"channels": ["pressure_pa", "position_m"]},
        "estimates": [{"method": "maximum_likelihood", "status": "ok", "parameters": parameters}],
        "discrepancy": {"verdict": "none", "causes": [], **discrepancy},
    }


def test_nothing_is_said_where_it_could_be_anything_else(nominal: Hidden) -> None:
    plate, rate = nominal.nameplate, nominal.nameplate.nominal_spring_rate_n_per_m
    assert rate is not None
    twice = (2.6, 2.7, 2.8)  # of 1.36 kg
    assert scale_note(analysed(twice, rate), plate) != ""
    assert scale_note(analysed((1.66, 1.7, 1.74), rate), plate) != "", "an area of 1.25 times the true one"
    assert scale_note(analysed((1.6, 2.7, 3.8), rate), plate) == "", "it may be less than 1.2 times"
    assert scale_note(analysed(twice, 1.2 * rate), plate) == "", "mass and spring rate are off by different factors"
    lag = {"verdict": "named", "causes": [{"cause": "position_lag"}]}
    assert scale_note(analysed(twice, rate, **lag), plate) == "", "a lag looks like mass"
    with_force = analysed(twice, rate) | {"recording": {"channels": ["pressure_pa", "force_n", "position_m"]}}
    assert scale_note(with_force, plate) == "", "the force says it better"
    command = analysed(twice, rate) | {"recording": {"channels": ["command_pa", "position_m"]}}
    assert scale_note(command, plate) == ""
