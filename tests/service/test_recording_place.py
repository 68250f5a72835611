from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.routes.recording_formats import CSV, PARQUET
from service.store.store import Store, open_store
from tests.service.nights import plant_text
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service

GATEWAYS = '[[gateways]]\nname = "g1"\nurl = "http://127.0.0.1:1"\n[[gateways]]\nname = "g2"\nurl = "http://south:2"\n'


@pytest.fixture
def plant(quick_path: Path) -> Plant:
    path = quick_path / "plant.toml"
    path.write_text(plant_text(GATEWAYS, 'gateway = "g1"', ("g1", "g2")), encoding="utf-8")
    return load_plant(path)


def _completed(store: Store, gateway: str) -> str:
    run = store.runs.insert(Run(id=new_run_id(), valve="B1", sequence="triangle", gateway=gateway))
    name = store.recording_path(run.id).name
    store.runs.save(replace(run, state=RunState.COMPLETED, recording_file=name, recording_sha256="0" * 64, analysis={}))
    return run.id


@pytest.mark.parametrize("accept", [CSV, PARQUET])
async def test_a_recording_that_another_gateway_made_is_asked_for_there(plant: Plant, accept: str) -> None:
    store = open_store(plant.service)
    made = {gateway: _completed(store, gateway) for gateway in ("g1", "g2", "gone")}
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        answers = {
            gateway: await client.get(f"/tests/{run_id}/recording", headers={"Accept": accept})
            for gateway, run_id in made.items()
        }
    assert_problem(answers["g2"], 421, "g2 made the recording and keeps it")
    assert (answers["g2"].json()["gateway"], answers["g2"].json()["url"]) == ("g2", "http://south:2")
    assert_problem(answers["g1"], 404, "no longer in the store")
    assert_problem(answers["gone"], 404, "does not say where that is")


async def test_a_recording_that_was_copied_here_is_given(plant: Plant) -> None:
    store = open_store(plant.service)
    run_id = _completed(store, "g2")
    store.recording_path(run_id).write_bytes(b"PAR1")
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        answer = await client.get(f"/tests/{run_id}/recording", headers={"Accept": PARQUET})
    assert answer.content == b"PAR1"
