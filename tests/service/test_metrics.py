from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
from prometheus_client.parser import text_string_to_metric_families

from service.access.principal import Role
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.store.store import open_store
from tests.service.access.signed_in import body_of, signed_in
from tests.service.health.analyses import analysis
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service


def samples(answer: httpx.Response) -> dict[tuple[str, ...], float]:
    """Return every sample by its name and the values of its labels."""
    assert answer.status_code == 200, answer.text
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


async def test_metrics_count_tests_and_need_a_viewer(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        viewer, engineer = served.tokens[Role.VIEWER], served.tokens[Role.ENGINEER]
        before = samples(await served.client.get("/metrics", headers=viewer))
        assert before["breakaway_tests", "completed"] == 0
        assert before["breakaway_valve_under_test", "FV-101"] == 0
        # There is no result yet that could be too old.
        assert (before["breakaway_valve_stale", "FV-101"], before["breakaway_valve_never_tested", "FV-101"]) == (0, 1)
        wanted = {"Prefer": "wait=10", **engineer}
        test = body_of(await served.client.post("/tests/run", json={"valve": "FV-101"}, headers=wanted))
        assert test["state"] == "completed"
        after = samples(await served.client.get("/metrics", headers=viewer))
        assert after["breakaway_tests", "completed"] == 1
        assert after["breakaway_safe_state_not_confirmed",] == 0
        assert after["breakaway_valve_last_test_timestamp_seconds", "FV-101"] > 1.0e9
        assert after["breakaway_valve_last_result_timestamp_seconds", "FV-101"] > 1.0e9
        assert (after["breakaway_valve_stale", "FV-101"], after["breakaway_valve_stale", "FV-102"]) == (0, 0)
        untested = [after["breakaway_valve_never_tested", tag] for tag in ("FV-101", "FV-102")]
        assert untested == [0, 1]
        assert not [sample for sample in after if sample[0].startswith("breakaway_mqtt")]  # the plant has no broker
        assert after["breakaway_audit_entries_total",] > before["breakaway_audit_entries_total",]
        assert after["process_resident_memory_bytes",] > 0
        assert after["breakaway_samples_total", "plc-1"] == test["quality"]["samples"]
        assert after["breakaway_motions_total", "plc-1", "completed"] == 1
        assert after["breakaway_analysis_seconds_count",] == 1
        assert after["breakaway_sampling_jitter_seconds_count", "plc-1"] == 1
        assert after["breakaway_sampling_lateness_seconds_count", "plc-1"] == test["quality"]["samples"]
        assert after["breakaway_sampling_lateness_seconds_bucket", "plc-1", "0.01"] == 0
        assert after["breakaway_sampling_lateness_seconds_bucket", "plc-1", "0.02"] == test["quality"]["samples"]
        assert_problem(await served.client.get("/metrics"), 401)


async def test_friction_dead_band_and_travel_are_those_of_the_last_result(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = open_store(plant.service)
    for friction_n, state in ((500.0, RunState.COMPLETED), (620.0, RunState.COMPLETED), (None, RunState.FAILED)):
        run = store.runs.insert(Run(id=new_run_id(), valve="FV-101", sequence="triangle"))
        found = None if friction_n is None else analysis(friction_n=friction_n, travel_m=0.09, dead_band_percent=7.5)
        store.runs.save(replace(run, state=state, analysis=found))
    run = store.runs.insert(Run(id=new_run_id(), valve="FV-102", sequence="triangle"))
    store.runs.save(replace(run, state=RunState.COMPLETED, analysis=analysis(friction_n=None, dead_band_percent=3.0)))
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        found_now = samples(await client.get("/metrics"))
    assert found_now["breakaway_valve_friction_newtons", "FV-101"] == 620.0
    assert found_now["breakaway_valve_dead_band_percent", "FV-101"] == 7.5
    assert found_now["breakaway_valve_travel_meters", "FV-101"] == 0.09
    assert found_now["breakaway_valve_dead_band_percent", "FV-102"] == 3.0
    assert ("breakaway_valve_friction_newtons", "FV-102") not in found_now, "what is unknown is no number"


async def test_a_safe_state_that_was_not_confirmed_stands_until_it_is_acknowledged(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        served.rig.safe_confirmed = False
        engineer = {"Prefer": "wait=10", **served.tokens[Role.ENGINEER]}
        test = body_of(await served.client.post("/tests/run", json={"valve": "FV-101"}, headers=engineer))
        found = samples(await served.client.get("/metrics", headers=engineer))
        assert found["breakaway_safe_state_not_confirmed",] == 1
        note = {"note": "looked at the valve, it is closed"}
        body_of(await served.client.post(f"{test['href']}/acknowledge", json=note, headers=engineer))
        found = samples(await served.client.get("/metrics", headers=engineer))
        assert found["breakaway_safe_state_not_confirmed",] == 0
        assert found["breakaway_motions_total", "plc-1", "completed"] == 1  # stored again, counted once


async def test_a_result_that_has_become_too_old_is_no_longer_normal(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    store = open_store(plant.service)
    long_ago = datetime.now(UTC) - timedelta(days=40)
    run = store.runs.insert(Run(id=new_run_id(), valve="FV-101", sequence="triangle", created_at=long_ago))
    analysis = {"health": {"ne107": "N", "reasons": []}}
    store.runs.save(replace(run, state=RunState.COMPLETED, finished_at=long_ago, analysis=analysis))
    later = store.runs.insert(Run(id=new_run_id(), valve="FV-101", sequence="triangle"))
    store.runs.save(replace(later, state=RunState.FAILED, error="no route to its bus"))  # a test, and no result
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        found = samples(await client.get("/metrics"))
        assert found["breakaway_valve_stale", "FV-101"] == 1
        assert [sample for sample in found if sample[0] == "breakaway_valve_ne107"] == [
            ("breakaway_valve_ne107", "C", "FV-101")
        ]
        assert found["breakaway_valve_last_test_timestamp_seconds", "FV-101"] > long_ago.timestamp() + 86400.0
        assert found["breakaway_valve_last_result_timestamp_seconds", "FV-101"] == long_ago.timestamp()
        health = (await client.get("/valves")).json()["valves"][0]["health"]
        assert health["ne107"] == "C"
        assert "40 days old" in health["reasons"][0]
