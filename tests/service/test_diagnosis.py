"""What is said of a valve, of every kind of recording that there is of it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from estimators.base import Estimate
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from service.analysis.diagnosis import assess
from service.cli.diagnosis_tables import diagnosis_lines
from simulator.recorded import recorded
from tests.support.rough_valves import RoughCase, case
from valve.effects import effect_from_values
from valve.waveform import steps

TIGHT_SPOT = {"rise_n": 570.0, "centre_m": 0.05, "width_m": 0.002}


def _assessed(made: RoughCase, estimate: Estimate) -> dict[str, Any]:
    found = assess([made.recording], made.nameplate, [estimate])
    json.dumps(found, allow_nan=False)
    return found


def _estimated(made: RoughCase) -> Estimate:
    return MaximumLikelihoodEstimator().estimate(made.recording, made.nameplate)


@pytest.mark.long  # of the examples in the documentation `make test` asks the same
def test_a_usual_valve_is_healthy_and_its_tight_spot_is_named() -> None:
    spot = effect_from_values("local_friction", TIGHT_SPOT)
    healthy, faulty = (case("nominal", "triangle", "usual", seed=7, effects=one) for one in ((), (spot,)))
    found = _assessed(healthy, _estimated(healthy))
    assert (found["verdict"], found["causes"]) == ("none", [])
    assert diagnosis_lines(found)[0].startswith("Diagnosis: no fault found. Friction varies by 1.")
    assert {one["direction"] for one in found["latent_friction"]} >= {"opening", "closing"}
    assert found["extended_model"] is None
    assert found["pictures"]["time"]["after_m"] is None
    found = _assessed(faulty, _estimated(faulty))
    assert [one["cause"] for one in found["causes"]] == ["local_friction"]
    place = found["causes"][0]["parameters"]["centre_m"]
    assert place["value"] == pytest.approx(TIGHT_SPOT["centre_m"], abs=0.002)
    assert set(found["extended_model"]["parameters"]) == {"k", "F_0", "F_c", "F_s"}


@pytest.mark.parametrize("period_s", [pytest.param(1.0e-3, marks=pytest.mark.long), 20.0e-3])
def test_a_tight_spot_is_named_by_the_command_alone_and_in_polled_rows(period_s: float) -> None:
    spot = effect_from_values("local_friction", TIGHT_SPOT)
    made = case("nominal", "triangle", "usual", period_s, 7, effects=(spot,), jitter_s=0.2 * period_s)
    commanded = replace(made, recording=replace(made.recording, pressure_pa=None))
    found = _assessed(commanded, _estimated(commanded))
    assert "local_friction" in [one["cause"] for one in found["causes"]]
    assert found["pictures"]["time"]["after_m"] is not None


def test_a_recording_in_steps_is_not_assessed_and_says_why() -> None:
    made = case("nominal", "triangle", "usual", 5.0e-3, 7)
    low_pa, high_pa = made.waveform.range_pa
    levels_pa = [low_pa, 0.5 * (low_pa + high_pa), high_pa, 0.5 * (low_pa + high_pa), low_pa]
    stepped, _ = recorded(made.settings, steps(levels_pa, 10.0), 5.0e-3)
    found = assess([stepped], made.nameplate, [])
    assert found["verdict"] == "not_assessed"
    assert "hardly slides in this test" in found["message"]


def test_a_model_of_an_earlier_version_is_not_used_and_that_is_said() -> None:
    made = case("nominal", "triangle", "usual", 20.0e-3, 7)
    old = {"schema": "breakaway/valve-model/1", "parameters": {}, "causes": {}}
    found = assess([made.recording], made.nameplate, [], accepted=old)
    assert found["verdict"] == "none"
    assert "was not used" in found["message"]
