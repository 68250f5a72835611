"""Accepting a valve's extended model, taking it back, and the separating test: what later analyses are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx

from service.config.plant import Plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem

RUN = {"valve": "FV-101", "sequence": "triangle"}
MODEL = {
    "schema": "breakaway/valve-model/2",
    "parameters": {"k": {"value": 52.5e3, "ci95": [52.4e3, 52.6e3], "unit": "N/m"}},
    "causes": {"friction_asymmetry": {"asymmetry": {"value": 0.1, "ci95": [0.09, 0.11], "unit": "1"}}},
}
NEXT = {"sequence": "multi_rate", "overrides": {"low_pa": 1.0e4, "high_pa": 6.0e4}, "sentence": "run it"}


def audit_files(plant: Plant) -> list[Path]:
    return sorted((plant.service.store / "audit").glob("*.audit"))


async def run_test(client: httpx.AsyncClient, **wanted: Any) -> dict[str, Any]:
    answer = await client.post("/tests/run", json={**RUN, **wanted}, headers={"Prefer": "wait=10"})
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    assert body["state"] == "completed", body["error"]
    return body


async def test_an_accepted_model_goes_with_later_analyses_until_it_is_taken_back(
    client: httpx.AsyncClient, analyst: FakeAnalyst
) -> None:
    assert_problem(await client.get("/valves/FV-101/model"), 404, "no model was accepted")
    analyst.discrepancy = {"verdict": "named", "extended_model": MODEL}
    first = await run_test(client)
    assert "accepted_model" not in first["analysis"]
    accepted = (await client.post("/valves/FV-101/model", json={"test": first["id"]})).json()
    assert (accepted["test"], accepted["model"], accepted["accepted_by"]) == (first["id"], MODEL, "local")
    assert (await client.get("/valves/FV-101/model")).json() == accepted
    second = await run_test(client)
    assert second["analysis"]["accepted_model"]["test"] == first["id"]
    assert (await client.delete("/valves/FV-101/model")).status_code == 204
    assert_problem(await client.delete("/valves/FV-101/model"), 404, "none to take back")
    await run_test(client)
    assert [given for _, _, given, _ in analyst.asked] == [None, MODEL, None]


async def test_a_newer_model_takes_the_place_of_the_older(client: httpx.AsyncClient, analyst: FakeAnalyst) -> None:
    analyst.discrepancy = {"verdict": "named", "extended_model": MODEL}
    runs = [await run_test(client) for _ in range(2)]
    for run in runs:
        assert (await client.post("/valves/FV-101/model", json={"test": run["id"]})).status_code == 200
    assert (await client.get("/valves/FV-101/model")).json()["test"] == runs[1]["id"]
    assert (await client.delete("/valves/FV-101/model")).status_code == 204
    assert_problem(await client.get("/valves/FV-101/model"), 404, "no model")


async def test_only_a_completed_test_of_the_valve_with_a_model_can_be_accepted(
    client: httpx.AsyncClient, analyst: FakeAnalyst
) -> None:
    analyst.discrepancy = {"verdict": "none", "extended_model": None}
    run = await run_test(client)
    answer = await client.post("/valves/FV-101/model", json={"test": run["id"]})
    assert_problem(answer, 422, "no extended model (diagnosis: none)")
    answer = await client.post("/valves/FV-102/model", json={"test": run["id"]})
    assert_problem(answer, 422, "one of FV-101, not of FV-102")
    answer = await client.post("/valves/FV-101/model", json={"test": "20260101T000000Z-00000000"})
    assert_problem(answer, 404, "unknown")
    assert_problem(await client.post("/valves/FV-9/model", json={"test": run["id"]}), 404, "FV-9")


async def test_a_cause_that_is_not_told_from_others_is_not_accepted(
    client: httpx.AsyncClient, analyst: FakeAnalyst
) -> None:
    rivals = ["friction_asymmetry", "presliding"]
    analyst.discrepancy = {"verdict": "ambiguous", "extended_model": MODEL, "not_told_apart_from": rivals}
    run = await run_test(client)
    answer = await client.post("/valves/FV-101/model", json={"test": run["id"]})
    assert_problem(answer, 422, "from friction_asymmetry, presliding: run the sequence separating first")
    assert "Judge later tests" not in (await client.get(f"/ui/tests/{run['id']}")).text


async def test_accepting_and_taking_back_stand_in_the_audit_log(
    client: httpx.AsyncClient, analyst: FakeAnalyst, plant: Plant
) -> None:
    analyst.discrepancy = {"verdict": "named", "extended_model": MODEL}
    run = await run_test(client)
    await client.post("/valves/FV-101/model", json={"test": run["id"]})
    await client.delete("/valves/FV-101/model")
    text = "".join(path.read_text() for path in audit_files(plant))
    assert text.index("model.accepted") < text.index("model.withdrawn")


async def test_the_separating_test_plays_what_the_last_one_asked_for_and_is_analysed_with_it(
    client: httpx.AsyncClient, rig: FakeRig, analyst: FakeAnalyst
) -> None:
    analyst.discrepancy = {"verdict": "ambiguous", "separating_test": NEXT}
    first = await run_test(client)
    second = await run_test(client, sequence="separating")
    assert second["sequence"] == "separating"
    assert rig.orders[1].sequence == "multi_rate"
    assert rig.orders[1].waveform.range_pa == (1.0e4, 6.0e4)
    assert [path.stem for path in analyst.asked[1][0]] == [first["id"]]
    assert second["analysis"]["together"] == {"sequence": "multi_rate", "tests": [first["id"]]}
    # what is still ambiguous is asked on, and all earlier recordings take part
    third = await run_test(client, sequence="separating")
    assert third["analysis"]["together"]["tests"] == [second["id"], first["id"]]


async def test_with_nothing_to_separate_nothing_moves_and_the_reason_is_told(
    client: httpx.AsyncClient, rig: FakeRig, analyst: FakeAnalyst
) -> None:
    separating = {**RUN, "sequence": "separating"}
    assert_problem(await client.post("/tests/run", json=separating), 422, "no test of it is completed")
    analyst.discrepancy = {"verdict": "named", "separating_test": None}
    run = await run_test(client)
    answer = await client.post("/tests/run", json=separating)
    assert_problem(answer, 422, f"test {run['id']} leaves nothing to separate (diagnosis: named)")
    answer = await client.post("/tests/run", json={**separating, "overrides": {"cycles": 2}})
    assert_problem(answer, 422, "takes no overrides")
    assert len(rig.orders) == 1


async def test_a_repeated_request_for_the_separating_test_gives_the_same_test(
    client: httpx.AsyncClient, analyst: FakeAnalyst, rig: FakeRig
) -> None:
    analyst.discrepancy = {"verdict": "ambiguous", "separating_test": NEXT}
    await run_test(client)
    analyst.discrepancy = {"verdict": "named", "separating_test": None}
    headers = {"Idempotency-Key": "once", "Prefer": "wait=10"}
    answers = [
        await client.post("/tests/run", json={**RUN, "sequence": "separating"}, headers=headers) for _ in range(2)
    ]
    assert answers[0].json()["id"] == answers[1].json()["id"]
    assert len(rig.orders) == 2


async def test_the_room_of_a_further_test_is_that_of_the_valves_limits_and_the_last_tests_pressures(
    client: httpx.AsyncClient, analyst: FakeAnalyst
) -> None:
    await run_test(client, overrides={"low_pa": 2.0e4})
    assert analyst.asked[0][3] == {"low_pa": 2.0e4, "high_pa": 82737.0, "rate_pa_per_s": 30000.0, "longest_s": 300.0}
