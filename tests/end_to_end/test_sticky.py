"""Over Modbus TCP: valves that hardly move, or late, are tested to the end; one that never moves is called stuck."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.config.settings import load_plant
from tests.bench.faults.healthy import Healthy, of_set, with_friction
from tests.support.fake_rig import FakeAnalyst
from tests.support.running_service import running_service
from tests.support.wired_plant import TAG, wired_plant
from valve.recording import Recording
from valve.recording_files import read_recording

GRAPHITE = of_set("graphite", lag_s=0.933, stops=True)  # at the low end of its range it is on its seat
STICKY = with_friction("dead band of 80 %", 0.8, 600.0, lag_s=0.3)
STUCK = with_friction("stuck", 4.0, 600.0)
WAVE_S = 6.0


async def outcome_of(folder: Path, valve: Healthy) -> tuple[dict[str, Any], Recording]:
    """Play one triangle over the whole range; what the service says of it, and what was recorded."""
    low_pa, high_pa = valve.range_pa
    order = {"low_pa": low_pa, "high_pa": high_pa, "cycles": 1, "period_s": WAVE_S}
    async with wired_plant(folder, valve=valve.simulated(), safe=str(low_pa), period_s=0.02) as (path, _):
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            asked = {"valve": TAG, "sequence": "triangle", "overrides": order}
            answer = await client.post("/tests/run", json=asked, headers={"Prefer": "wait=60"}, timeout=90.0)
            body: dict[str, Any] = answer.json()
        assert "id" in body, body
        return body, read_recording(folder / "plant-data" / "recordings" / f"{body['id']}.parquet")


@pytest.mark.parametrize(("valve", "moved"), [(GRAPHITE, 0.7), (STICKY, 0.4)], ids=["graphite", "sticky"])
async def test_a_valve_that_moves_late_is_tested_to_the_end(tmp_path: Path, valve: Healthy, moved: float) -> None:
    body, recording = await outcome_of(tmp_path, valve)
    assert body["state"] == "completed", body["error"]
    assert body["safe_confirmed"] is True
    assert float(np.nanmax(recording.position_m) - np.nanmin(recording.position_m)) > moved * (
        valve.nameplate.actuator.travel_m
    )


async def test_one_that_never_moves_is_called_stuck(tmp_path: Path) -> None:
    body, recording = await outcome_of(tmp_path, STUCK)
    assert body["state"] == "failed"
    assert "did not break away" in body["error"]
    assert body["safe_confirmed"] is True
    assert float(np.nanmax(recording.position_m) - np.nanmin(recording.position_m)) < 1.0e-3
