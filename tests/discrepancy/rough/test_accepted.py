"""A model that was accepted: saved, read back, and what later tests of its valve are told beside it."""

from __future__ import annotations

import json
from functools import cache

import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis, Verdict
from discrepancy.rough.saved_model import SCHEMA, SavedModel
from tests.support.rough_valves import VALVES, case
from valve.effects.base import Effect
from valve.effects.friction_drift import FrictionDrift
from valve.effects.local_friction import LocalFriction
from valve.effects.spring_preload import SpringPreload
from valve.errors import RequestError

_FRICTION_N = 1120.0
_TRAVEL_M = 0.06


def _spot(rise: float) -> Effect:
    return LocalFriction(rise * _FRICTION_N, 0.4 * _TRAVEL_M, 0.025 * _TRAVEL_M)


def _diagnosed(*effects: Effect, occasion: int = 0, model: SavedModel | None = None) -> RoughDiagnosis:
    made = case("large", "triangle", "usual", seed=32, occasion=occasion, effects=effects)
    return diagnose(made.recording, made.nameplate, model=model)


@cache
def _accepted() -> SavedModel:
    """Return the model of a valve with a tight spot, through the JSON that is stored."""
    found = _diagnosed(_spot(0.35))
    assert found.extended is not None
    return SavedModel.from_json(json.loads(json.dumps(found.extended.to_json())))


def test_the_saved_model_has_what_was_fitted_with_intervals() -> None:
    saved = _accepted().to_json()
    assert saved["schema"] == SCHEMA
    assert list(saved["parameters"]) == ["k", "F_0", "F_c", "F_s"]
    rise = saved["causes"]["local_friction"]["rise_n"]
    assert rise["ci95"][0] < rise["value"] < rise["ci95"][1]


def test_the_same_effect_is_nothing_new_once_its_model_is_accepted() -> None:
    found = _diagnosed(_spot(0.35), occasion=1, model=_accepted())
    assert found.verdict is Verdict.NONE
    assert "accepted" in found.message
    assert found.extended is None


def test_a_stronger_effect_is_named_again_with_what_it_was() -> None:
    found = _diagnosed(_spot(0.8), occasion=2, model=_accepted())
    assert [one.cause for one in found.causes] == ["local_friction"]
    (cause,) = found.causes
    assert cause.parameters["rise_n"].value == pytest.approx(0.8 * _FRICTION_N, rel=0.25)
    assert "Since its model was accepted rise_n went from" in cause.sentence
    assert found.gain is not None
    assert found.gain.rmse_after_m < found.gain.rmse_before_m
    assert found.extended is not None
    assert found.extended.causes["local_friction"]["rise_n"] == cause.parameters["rise_n"]


def test_an_effect_that_went_away_is_told() -> None:
    found = _diagnosed(occasion=3, model=_accepted())
    assert [one.cause for one in found.causes] == ["local_friction"]
    assert "is gone" in found.causes[0].sentence


def test_a_new_cause_is_named_beside_the_accepted_one() -> None:
    found = _diagnosed(_spot(0.35), FrictionDrift(-0.35 * _FRICTION_N, 25.0), occasion=4, model=_accepted())
    assert [one.cause for one in found.causes] == ["friction_drift"]
    assert found.extended is not None
    assert set(found.extended.causes) == {"local_friction", "friction_drift"}


@pytest.mark.long
def test_an_accepted_preload_moves_the_nameplates_bench_set() -> None:
    area_m2 = VALVES["large"][1].actuator.diaphragm_area_m2
    assert area_m2 is not None
    offset_n = 0.05 * area_m2 * 1.0e5
    found = _diagnosed(SpringPreload(offset_n))
    assert "spring_preload" in {one.cause for one in found.causes} | set(found.not_told_apart_from)
    assert found.extended is not None
    again = _diagnosed(SpringPreload(offset_n), occasion=5, model=found.extended)
    assert again.verdict is Verdict.NONE


def test_a_model_of_another_schema_or_with_an_unknown_cause_is_refused() -> None:
    saved = _accepted().to_json()
    with pytest.raises(RequestError, match="schema"):
        SavedModel.from_json({**saved, "schema": "breakaway/valve-model/9"})
    with pytest.raises(RequestError, match="magic"):
        SavedModel.from_json({**saved, "causes": {"magic": {}}})
    with pytest.raises(RequestError, match="cannot be read"):
        SavedModel.from_json({**saved, "parameters": {"m": {"value": "heavy"}}})
