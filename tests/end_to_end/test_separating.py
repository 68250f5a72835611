"""Over Modbus, from an ambiguous diagnosis to a named cause: the separating test, read together with the first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

from service.settings import load_plant
from tests.service.running_service import running_service
from tests.service.wired_plant import TAG, wired_plant
from valve.effects import effect_from_values

# A spring whose rate rises by 0.8 % over the travel: in two equal triangles a bowed position reading looks the same.
HIDDEN = effect_from_values("spring_hardening", {"hardening_n_per_m2": 4000.0})
FIRST = {"valve": TAG, "sequence": "triangle", "overrides": {"period_s": 12.0, "cycles": 2}}
WAIT = {"Prefer": "wait=300"}


async def completed(client: httpx.AsyncClient, order: dict[str, Any]) -> dict[str, Any]:
    body: dict[str, Any] = (await client.post("/tests/run", json=order, headers=WAIT, timeout=320.0)).json()
    assert body.get("state") == "completed", body
    return body


@pytest.mark.long
async def test_an_ambiguous_pair_becomes_named_by_the_separating_test(tmp_path: Path) -> None:
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
        assert found["separating_test"]["sentence"]
        second = await completed(client, {"valve": TAG, "sequence": "separating"})
        told = second["analysis"]["discrepancy"]
        assert second["analysis"]["together"]["tests"] == [first["id"]]
        assert told["verdict"] == "named", told["not_told_apart_from"]
        assert [cause["cause"] for cause in told["causes"]] == ["spring_hardening"]
        strength = told["causes"][0]["parameters"]["hardening_n_per_m2"]
        assert abs(strength["value"] - 4000.0) < 400.0
