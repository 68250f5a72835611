"""The service's own polled play against the simulator: its recording's input is the staircase of its writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimators.likelihood.inputs.commanded_path import CommandedPath
from estimators.likelihood.inputs.input_path import input_path
from service.settings import load_plant
from tests.service.fake_rig import FakeAnalyst
from tests.service.running_service import running_service
from tests.service.wired_plant import TAG, wired_plant
from valve.parameter_sets import PARAMETER_SETS
from valve.recording_files import read_recording

ORDER = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 4.0, "low_pa": 30_000.0, "high_pa": 60_000.0}}


async def test_a_polled_plays_pressure_is_the_answer_to_its_writes(quick_path: Path) -> None:
    async with wired_plant(quick_path, period_s=0.02) as (path, plant):
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            body = (await client.post("/tests/run", json=ORDER, headers={"Prefer": "wait=30"})).json()
        assert body["state"] == "completed", body["error"]
        recording = read_recording(quick_path / "plant-data" / "recordings" / f"{body['id']}.parquet")
        found = input_path(recording, PARAMETER_SETS["nominal"].nameplate)
        assert isinstance(found, CommandedPath)
        # the simulated I/P has neither lag nor error
        assert found.fit.linear[1] == pytest.approx(1.0, abs=1.0e-3)
        assert found.fit.lag_s < 2.0e-3
        assert -0.02 < found.fit.dead_time_s < 0.02
        written = np.unique(plant.records[TAG].track.asked_pa)
        area_m2 = PARAMETER_SETS["nominal"].nameplate.actuator.diaphragm_area_m2
        assert area_m2 is not None
        off_pa = [float(np.abs(written - level_n / area_m2).min()) for level_n in found.level_n]
        assert max(off_pa) < 2.0
