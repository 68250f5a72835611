"""Which way a valve is diagnosed: whether it repeats itself, and what is said of one that does not."""

from __future__ import annotations

import json
from typing import Any

import pytest

from estimators.base import Estimate
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.repetition import repetition
from service import diagnosis
from service.cli.diagnosis_tables import diagnosis_lines
from service.diagnosis import assess
from service.friction_scatter import REPEATS_ITSELF
from tests.rough_valves import RoughCase, case
from valve.effects import effect_from_values

TIGHT_SPOT = {"rise_n": 570.0, "centre_m": 0.05, "width_m": 0.002}


def _share(made: RoughCase) -> float:
    scatter_n = repetition(made.recording, made.nameplate).scatter_n
    assert scatter_n is not None
    return scatter_n / made.truth.parameters.static_friction_n


@pytest.mark.parametrize("valve", ["nominal", "rough"])
@pytest.mark.parametrize("sequence", ["triangle", "multi_rate"])
def test_breakaways_at_one_place_tell_a_packing_from_a_valve_that_repeats_itself(valve: str, sequence: str) -> None:
    assert _share(case(valve, sequence, "ideal", seed=3)) < REPEATS_ITSELF
    assert _share(case(valve, sequence, "mild", seed=3)) > REPEATS_ITSELF


def test_an_effect_that_comes_back_at_its_place_is_no_scatter() -> None:
    spot = effect_from_values("local_friction", TIGHT_SPOT)
    assert _share(case("nominal", "triangle", "ideal", seed=3, effects=(spot,))) < REPEATS_ITSELF


def _assessed(made: RoughCase, estimate: Estimate) -> dict[str, Any]:
    found = assess([made.recording], made.nameplate, [estimate])
    json.dumps(found, allow_nan=False)
    return found


def test_a_usual_valve_is_healthy_and_its_tight_spot_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_arguments: Any, **_named: Any) -> None:
        raise AssertionError("the search for valves that repeat themselves takes minutes on another")

    monkeypatch.setattr(diagnosis, "diagnose", never)
    spot = effect_from_values("local_friction", TIGHT_SPOT)
    healthy, faulty = (case("nominal", "triangle", "usual", seed=7, effects=one) for one in ((), (spot,)))
    found = _assessed(healthy, MaximumLikelihoodEstimator().estimate(healthy.recording, healthy.nameplate))
    assert (found["verdict"], found["causes"]) == ("none", [])
    assert diagnosis_lines(found)[0].startswith("Diagnosis: no fault found. Friction varies by 1.")
    assert {one["direction"] for one in found["latent_friction"]} >= {"opening", "closing"}
    found = _assessed(faulty, MaximumLikelihoodEstimator().estimate(faulty.recording, faulty.nameplate))
    assert [one["cause"] for one in found["causes"]] == ["local_friction"]
    place = found["causes"][0]["parameters"]["centre_m"]
    assert place["value"] == pytest.approx(TIGHT_SPOT["centre_m"], abs=0.002)
