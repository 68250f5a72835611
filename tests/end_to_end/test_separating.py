"""Over Modbus, an ambiguous diagnosis: which sequence separates the causes, or that none does and nothing moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config.settings import load_plant
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from tests.support.wired_plant import TAG, wired_plant
from valve.effects import effect_from_values

# A spring whose rate rises along the travel: a bowed position reading has the same balance of forces in every test.
HIDDEN = effect_from_values("spring_hardening", {"hardening_n_per_m2": 4000.0})
FIRST = {"valve": TAG, "sequence": "triangle", "overrides": {"period_s": 12.0, "cycles": 2}}
WAIT = {"Prefer": "wait=300"}


async def completed(client: httpx.AsyncClient, order: dict[str, Any]) -> dict[str, Any]:
    body: dict[str, Any] = (await client.post("/tests/run", json=order, headers=WAIT, timeout=320.0)).json()
    assert body.get("state") == "completed", body
    return body


@pytest.mark.long
async def test_causes_with_the_same_balance_of_forces_are_told_as_such_and_nothing_moves(tmp_path: Path) -> None:
    wired = wired_plant(
        tmp_path,
        mode="captured",
        period_s=0.002,
        speed=30.0,
        parameter_set="vendor",
        effects=(HIDDEN,),
        position_noise_m=20.0e-6,
    )
    async with wired as (path, _), running_service(load_plant(path), None, None) as client:
        first = await completed(client, FIRST)
        found = first["analysis"]["discrepancy"]
        assert found["verdict"] == "ambiguous", found["message"]
        assert "spring_hardening" in [found["causes"][0]["cause"], *found["not_told_apart_from"]]
        assert found["separating_test"] is None
        assert "No sequence that the valve's limits allow would tell these causes apart." in found["message"]
        answer = await client.post("/tests/run", json={"valve": TAG, "sequence": "separating"}, headers=WAIT)
        assert_problem(answer, 422, "leaves nothing to separate (diagnosis: ambiguous)")
