from __future__ import annotations

from pathlib import Path

import httpx
from prometheus_client.parser import text_string_to_metric_families

from service.access.principal import Role
from tests.service.access.signed_in import body_of, signed_in
from tests.service.problem import assert_problem


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
        wanted = {"Prefer": "wait=10", **engineer}
        test = body_of(await served.client.post("/tests/run", json={"valve": "FV-101"}, headers=wanted))
        assert test["state"] == "completed"
        after = samples(await served.client.get("/metrics", headers=viewer))
        assert after["breakaway_tests", "completed"] == 1
        assert after["breakaway_safe_state_not_confirmed",] == 0
        assert after["breakaway_valve_last_test_timestamp_seconds", "FV-101"] > 1.0e9
        assert after["breakaway_audit_entries_total",] > before["breakaway_audit_entries_total",]
        assert after["process_resident_memory_bytes",] > 0
        assert after["breakaway_samples_total", "plc-1"] == test["quality"]["samples"]
        assert after["breakaway_motions_total", "plc-1", "completed"] == 1
        assert after["breakaway_analysis_seconds_count",] == 1
        assert after["breakaway_sampling_jitter_seconds_count", "plc-1"] == 1
        assert_problem(await served.client.get("/metrics"), 401)


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
