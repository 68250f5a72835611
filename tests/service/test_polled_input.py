"""The service's own polled play against the simulator: its recording's input is the staircase of its writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from service.config.settings import load_plant
from tests.support.fake_rig import FakeAnalyst
from tests.support.running_service import running_service
from tests.support.wired_plant import TAG, wired_plant
from valve.recording_files import read_recording

ORDER = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 4.0, "low_pa": 30_000.0, "high_pa": 60_000.0}}


async def test_a_polled_plays_pressure_is_the_answer_to_its_writes(quick_path: Path) -> None:
    async with wired_plant(quick_path, period_s=0.02) as (path, plant):
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            body = (await client.post("/tests/run", json=ORDER, headers={"Prefer": "wait=30"})).json()
        assert body["state"] == "completed", body["error"]
        recording = read_recording(quick_path / "plant-data" / "recordings" / f"{body['id']}.parquet")
        assert recording.command_pa is not None
        assert recording.pressure_pa is not None
        # the simulated I/P has neither lag nor error: away from a write the gauge shows what was written
        written = np.unique(plant.records[TAG].track.asked_pa)
        off_pa = np.abs(recording.pressure_pa[:, None] - written[None, :]).min(axis=1)
        assert float(np.median(off_pa)) < 5.0
        asked_pa = np.unique(recording.command_pa[np.isfinite(recording.command_pa)])
        assert float(np.abs(asked_pa[:, None] - written[None, :]).min(axis=1).max()) < 2.0
        held_pa, gauge_pa = recording.command_pa[:-1], recording.pressure_pa[1:]
        gain, offset_pa = np.polyfit(held_pa, gauge_pa, 1)
        assert gain == pytest.approx(1.0, abs=0.01)
        assert abs(offset_pa) < 500.0
