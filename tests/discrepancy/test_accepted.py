"""A model that was accepted: saved, read back, and what later tests of its valve are told beside it."""

from __future__ import annotations

import json
import re
from functools import cache, partial

import pytest

from discrepancy.diagnose import Diagnosis, Verdict, diagnose
from discrepancy.saved_model import SCHEMA, SavedModel, saved_model
from tests.discrepancy.hidden import Hidden, hidden
from valve.effects import Effect, effect_from_values
from valve.errors import RequestError

pytestmark = pytest.mark.long

# Faster and coarser than a test is: what is looked for here shows all the same, in half of the time.
short = partial(hidden, cycle_s=8.0, period_s=4.0e-3)


def spot(rise_n: float) -> Effect:
    return effect_from_values("local_friction", {"rise_n": rise_n, "centre_m": 0.055, "width_m": 0.0015})


def diagnosed(case: Hidden, accepted: SavedModel | None = None) -> Diagnosis:
    return diagnose([case.recording], case.nameplate, accepted=accepted)


@cache
def with_a_spot() -> SavedModel:
    """Return the model of a valve with a tight spot, through the JSON that is stored."""
    found = diagnosed(short("nominal", spot(150.0), seed=3))
    assert found.extended is not None
    return SavedModel.from_json(json.loads(json.dumps(saved_model(found.extended, found.causes).to_json())))


def test_the_saved_model_has_the_valves_parameters_and_the_causes_with_intervals() -> None:
    saved = with_a_spot().to_json()
    assert saved["schema"] == SCHEMA
    assert list(saved["parameters"]) == ["m", "k", "F_v", "F_c", "F_s", "DV", "F_0"]
    rise = saved["causes"]["local_friction"]["rise_n"]
    assert rise["value"] == pytest.approx(150.0, rel=0.02)
    assert rise["ci95"][0] < rise["value"] < rise["ci95"][1]
    assert saved["parameters"]["F_c"]["ci95"][0] < 1423.4 < saved["parameters"]["F_c"]["ci95"][1]


def test_the_same_effect_is_nothing_new_once_its_model_is_accepted() -> None:
    found = diagnosed(short("nominal", spot(150.0), seed=13), with_a_spot())
    assert found.verdict is Verdict.NONE
    assert "accepted" in found.message


def test_a_stronger_effect_is_named_again_with_what_it_was() -> None:
    found = diagnosed(short("nominal", spot(300.0), seed=23), with_a_spot())
    assert found.verdict is Verdict.NAMED
    (cause,) = found.causes
    assert cause.cause == "local_friction"
    assert cause.parameters["rise_n"].value == pytest.approx(300.0, rel=0.02)
    # 150 N within the interval of 0.4 N that a valve of this noise gives
    assert re.search(r"from 1(49\.[6-9]|50|50\.[1-4]) N to 300", cause.sentence)
    gain = found.to_json()["gain"]
    assert gain["rmse_after_m"] < 0.2 * gain["rmse_before_m"]


def test_an_effect_that_went_away_is_told() -> None:
    found = diagnosed(short("nominal", seed=33), with_a_spot())
    assert [one.cause for one in found.causes] == ["local_friction"]
    assert "is gone" in found.causes[0].sentence


def test_a_new_cause_is_named_beside_the_accepted_one() -> None:
    lag = effect_from_values("position_lag", {"lag_s": 0.03})
    found = diagnosed(short("nominal", spot(150.0), lag, seed=43), with_a_spot())
    assert [one.cause for one in found.causes] == ["position_lag"]
    assert found.extended is not None
    assert set(saved_model(found.extended, found.causes).causes) == {"local_friction", "position_lag"}


def test_an_accepted_preload_moves_the_nameplates_bench_set() -> None:
    case = short("nominal", effect_from_values("spring_preload", {"offset_n": 120.0}), seed=5)
    found = diagnosed(case)
    assert found.extended is not None
    accepted = saved_model(found.extended, found.causes)
    assert diagnosed(case, accepted).verdict is Verdict.NONE


def test_a_model_of_another_schema_or_with_an_unknown_cause_is_refused() -> None:
    saved = with_a_spot().to_json()
    with pytest.raises(RequestError, match="schema"):
        SavedModel.from_json({**saved, "schema": "breakaway/valve-model/9"})
    with pytest.raises(RequestError, match="magic"):
        SavedModel.from_json({**saved, "causes": {"magic": {}}})
    with pytest.raises(RequestError, match="cannot be read"):
        SavedModel.from_json({**saved, "parameters": {"m": {"value": "heavy"}}})
