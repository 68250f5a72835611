from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config.plant import Plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from tests.support.stopwatch import Stopwatch

RUN = {"valve": "FV-101"}
LONG_S = 30.0


async def finished(client: httpx.AsyncClient, location: str, within_s: float = 60.0) -> dict[str, Any]:
    deadline_s = time.monotonic() + within_s
    while time.monotonic() < deadline_s:
        body: dict[str, Any] = (await client.get(location)).json()
        if body["state"] in ("completed", "failed", "stopped", "interrupted"):
            return body
        await asyncio.sleep(0.01)
    raise AssertionError(f"{location} did not end within {within_s} s")


async def test_a_test_is_accepted_run_analysed_and_listed(client: httpx.AsyncClient, rig: FakeRig) -> None:
    answer = await client.post("/tests/run", json={**RUN, "sequence": "triangle", "overrides": {"cycles": 2}})
    assert answer.status_code == 202
    location = answer.headers["location"]
    assert location == f"/tests/{answer.json()['id']}"
    body = await finished(client, location)
    assert body["state"] == "completed"
    assert body["progress"] == 1.0
    assert body["analysis"]["schema"] == "breakaway/analysis/1"
    assert body["safe_confirmed"] is True
    assert body["quality"]["samples"] == 200
    assert body["quality"]["notes"] == ["no wire"]
    assert rig.orders[0].waveform.duration_s == 40.0
    assert rig.orders[0].run_number == body["run_number"] == 1
    page = (await client.get("/tests")).json()
    assert [test["id"] for test in page["tests"]] == [body["id"]]
    assert page["next"] is None


@pytest.mark.parametrize(
    ("wanted", "sequence"), [({}, "multi_rate"), ({"overrides": {"cycles": 2, "period_s": 20}}, "triangle")]
)
async def test_without_a_sequence_the_usual_one_is_run(
    client: httpx.AsyncClient, rig: FakeRig, wanted: dict[str, Any], sequence: str
) -> None:
    answer = await client.post("/tests/run", json={"valve": "FV-101", **wanted})
    assert answer.json()["sequence"] == sequence
    await finished(client, answer.headers["location"])
    assert rig.orders[0].sequence == sequence


async def test_prefer_wait_answers_200_with_the_completed_test(client: httpx.AsyncClient) -> None:
    answer = await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})
    assert answer.status_code == 200
    assert answer.headers["preference-applied"] == "wait=10"
    assert answer.json()["state"] == "completed"


async def test_prefer_wait_answers_202_when_the_time_is_over(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = LONG_S
    watch, started_s = Stopwatch(), time.monotonic()
    answer = await client.post("/tests/run", json=RUN, headers={"Prefer": "respond-async, wait=1"})
    assert time.monotonic() - started_s > 0.9
    assert watch.own_s < 5.0
    assert answer.status_code == 202
    assert answer.json()["state"] == "running"


async def test_fifty_parallel_posts_make_one_test_and_49_conflicts(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = LONG_S
    answers = await asyncio.gather(*(client.post("/tests/run", json=RUN) for _ in range(50)))
    assert sorted(answer.status_code for answer in answers) == [202] + [409] * 49
    for answer in answers:
        if answer.status_code == 409:
            assert_problem(answer, 409, "FV-101", "wait")
    assert len((await client.get("/tests")).json()["tests"]) == 1
    assert len(rig.orders) == 1


async def test_fifty_parallel_posts_with_one_key_are_one_test(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = LONG_S
    headers = {"Idempotency-Key": "shift-7"}
    answers = await asyncio.gather(*(client.post("/tests/run", json=RUN, headers=headers) for _ in range(50)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({answer.headers["location"] for answer in answers}) == 1
    other = await client.post("/tests/run", json={**RUN, "sequence": "sine"}, headers=headers)
    assert_problem(other, 422, "shift-7", "another request")


async def test_a_key_still_names_its_test_after_the_test_has_ended(client: httpx.AsyncClient) -> None:
    headers = {"Idempotency-Key": "k", "Prefer": "wait=10"}
    first = await client.post("/tests/run", json=RUN, headers=headers)
    second = await client.post("/tests/run", json=RUN, headers=headers)
    assert first.json()["id"] == second.json()["id"]
    assert second.status_code == 200


@pytest.mark.parametrize("sequence", ["triangle", "separating"])
async def test_a_key_stands_for_one_label_and_one_permit(
    client: httpx.AsyncClient, analyst: FakeAnalyst, rig: FakeRig, sequence: str
) -> None:
    analyst.discrepancy = {"verdict": "ambiguous", "separating_test": {"sequence": "triangle", "overrides": {}}}
    assert (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()["state"] == "completed"
    headers = {"Idempotency-Key": "k", "Prefer": "wait=10"}
    asked = {"valve": "FV-101", "sequence": sequence, "label": "as_found", "permit": "W-17"}
    first = await client.post("/tests/run", json=asked, headers=headers)
    assert (first.json()["state"], first.json()["label"]) == ("completed", "as_found")
    assert (await client.post("/tests/run", json=asked, headers=headers)).json()["id"] == first.json()["id"]
    for change in ({"label": "as_left"}, {"label": None}, {"permit": "W-18"}, {"permit": None}):
        answer = await client.post("/tests/run", json={**asked, **change}, headers=headers)
        assert_problem(answer, 422, "another request", "choose a new key")
    assert len(rig.orders) == 2


async def test_a_valve_whose_bus_is_used_is_busy_too(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = LONG_S
    await client.post("/tests/run", json=RUN)
    assert_problem(await client.post("/tests/run", json={"valve": "FV-102"}), 409, "plc-1")


async def test_stop_sends_the_valve_to_safe_within_a_second_and_may_be_repeated(
    client: httpx.AsyncClient, rig: FakeRig
) -> None:
    rig.duration_s = LONG_S / 5
    location = (await client.post("/tests/run", json=RUN)).headers["location"]
    await rig.moving.wait()
    watch = Stopwatch()
    answer = await client.post(f"{location}/stop")
    assert watch.own_s < 1.0
    assert answer.status_code == 200
    body = await finished(client, location)
    assert body["state"] == "stopped"
    assert body["safe_confirmed"] is True
    assert "stopped by local" in body["error"]
    async with asyncio.timeout(10.0):
        while body["stands"]["verdict"] == "moving":  # its stem is looked at
            await asyncio.sleep(0.01)
            body = (await client.get(location)).json()
    assert (await client.post(f"{location}/stop")).json() == body
    again = await client.post("/tests/run", json=RUN)
    assert again.status_code == 202


async def test_a_valve_that_was_not_seen_safe_is_said_so(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.safe_confirmed = False
    body = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    assert body["state"] == "failed"
    assert body["safe_confirmed"] is False
    assert "SAFE STATE NOT CONFIRMED" in body["error"]
    assert body["recording"] is not None


async def test_a_test_that_is_refused_by_the_device_moved_nothing(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.refusal = rig.failure
    body = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    assert body["state"] == "failed"
    assert "nothing was moved" in body["error"]
    assert body["safe_confirmed"] is None
    assert_problem(await client.get(f"/tests/{body['id']}/recording"), 404, "no recording")


async def test_a_fault_of_ours_in_mid_motion_still_sends_the_valve_to_safe(
    client: httpx.AsyncClient, rig: FakeRig
) -> None:
    rig.break_at, rig.failure = 0.5, ZeroDivisionError("oops")
    body = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    assert body["state"] == "failed"
    assert "ZeroDivisionError" in body["error"]
    assert rig.safe_calls == [("FV-101", 1, 1234.0)]
    assert body["safe_confirmed"] is True


def parse_events(text: str) -> list[tuple[int, str, dict[str, Any]]]:
    events = []
    for chunk in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in chunk.splitlines() if not line.startswith(":"))
        if fields:
            events.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
    return events


async def test_the_event_stream_tells_progress_samples_and_the_end(client: httpx.AsyncClient) -> None:
    location = (await client.post("/tests/run", json=RUN)).headers["location"]
    answer = await client.get(f"{location}/events")
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = parse_events(answer.text)
    assert [event[0] for event in events] == list(range(1, len(events) + 1))
    kinds = [kind for _, kind, _ in events]
    assert {"state", "progress", "samples"} <= set(kinds)
    assert kinds[-1] == "end"
    assert events[-1][2]["state"] == "completed"
    samples = [data for _, kind, data in events if kind == "samples"]
    times_s = [time_s for data in samples for time_s in data["time_s"]]
    assert times_s == sorted(times_s)
    assert samples[0]["pressure_pa"][0] is None


async def test_the_event_stream_resumes_after_the_last_event_id(client: httpx.AsyncClient) -> None:
    location = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).headers["location"]
    everything = parse_events((await client.get(f"{location}/events")).text)
    rest = parse_events((await client.get(f"{location}/events", headers={"Last-Event-ID": "5"})).text)
    assert rest == everything[5:]


async def test_a_watcher_that_leaves_does_not_disturb_the_test(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = 0.3
    location = (await client.post("/tests/run", json=RUN)).headers["location"]
    async with client.stream("GET", f"{location}/events") as answer:
        async for _ in answer.aiter_lines():
            break
    assert (await finished(client, location))["state"] == "completed"


async def test_the_recording_comes_as_csv_or_parquet(client: httpx.AsyncClient, tmp_path: Path) -> None:
    body = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    href = body["recording"]["href"]
    csv = await client.get(href)
    assert csv.headers["content-type"].startswith("text/csv")
    assert csv.text.splitlines()[0].startswith("time_s,")
    assert len(csv.text.splitlines()) == 201
    parquet = await client.get(href, headers={"Accept": "application/vnd.apache.parquet"})
    assert parquet.content[:4] == b"PAR1"
    assert parquet.headers["etag"] == f'"{body["recording"]["sha256"]}"'
    assert_problem(await client.get(href, headers={"Accept": "image/png"}), 406, "text/csv")


BAD_BODIES: dict[str, tuple[str, int]] = {
    "no JSON": ("{", 422),
    "a list": ("[]", 422),
    "an empty object": ("{}", 422),
    "an extra field": ('{"valve": "FV-101", "host": "10.0.0.1"}', 422),
    "a number as tag": ('{"valve": 101}', 422),
    "an unknown sequence": ('{"valve": "FV-101", "sequence": "waltz"}', 422),
    "an unknown override": ('{"valve": "FV-101", "overrides": {"cycle": 2}}', 422),
    "NaN": ('{"valve": "FV-101", "overrides": {"period_s": NaN}}', 422),
    "infinity": ('{"valve": "FV-101", "overrides": {"period_s": 1e400}}', 422),
    "a huge integer": ('{"valve": "FV-101", "overrides": {"cycles": ' + "9" * 5000 + "}}", 422),
    "a negative period": ('{"valve": "FV-101", "overrides": {"period_s": -1}}', 422),
    "a boolean for a number": ('{"valve": "FV-101", "overrides": {"cycles": true}}', 422),
    "a wave that falls": ('{"valve": "FV-101", "overrides": {"low_pa": 5000, "high_pa": 1000}}', 422),
    "a wave that is too steep": ('{"valve": "FV-101", "overrides": {"period_s": 0.5}}', 422),
    "deep nesting": ('{"valve": "FV-101", "overrides": ' + '{"a":' * 8000 + "1" + "}" * 8001, 422),
    "a broken character": ('{"valve": "\\ud800"}', 422),
    "an unknown valve": ('{"valve": "FV-999"}', 404),
    "a path as valve": ('{"valve": "../FV-101"}', 404),
    "a body of 70 KiB": ('{"valve": "' + "A" * 70_000 + '"}', 413),
}


async def test_a_bad_body_is_refused_and_nothing_moves(client: httpx.AsyncClient, rig: FakeRig) -> None:
    for name, (body, status) in BAD_BODIES.items():
        answer = await client.post("/tests/run", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code in ((400, 422) if status == 422 else (status,)), f"{name}: {answer.text}"
        assert_problem(answer, answer.status_code)
    assert rig.orders == []
    assert (await client.get("/tests")).json()["tests"] == []


async def test_a_wrong_key_is_told_with_the_right_one_and_a_wrong_value_with_its_limit(
    client: httpx.AsyncClient, rig: FakeRig
) -> None:
    for body, parts in (
        ({"sequnce": "triangle"}, ["body.sequnce: this key is unknown, did you mean sequence?"]),
        ({"host": "10.0.0.1"}, ["body.host: this key is unknown, known here are valve, sequence, overrides"]),
        ({"overrides": {"cycle": 2}, "sequence": "triangle"}, ["cycle: this key is unknown, did you mean cycles?"]),
        ({"overrides": {"cycles": 2000}, "sequence": "triangle"}, ["cycles is 2000:", "less than or equal to 1000"]),
        ({"overrides": {"low_pa": "9" * 500}}, ["low_pa is '99", "999...: input should be a valid number"]),
    ):
        assert_problem(await client.post("/tests/run", json={"valve": "FV-101", **body}), 422, *parts)
    assert_problem(await client.post("/valves/FV-101/model", json={"tests": "x"}), 422, "did you mean test?")
    assert rig.orders == []


async def test_a_body_that_does_not_say_its_length_is_cut_too(client: httpx.AsyncClient) -> None:
    async def endless() -> AsyncIterator[bytes]:
        for _ in range(100):
            yield b" " * 10_000

    answer = await client.post("/tests/run", content=endless(), headers={"Content-Type": "application/json"})
    assert_problem(answer, 413, "64 KiB")


async def test_every_wrong_address_is_a_problem_document(client: httpx.AsyncClient) -> None:
    assert_problem(await client.get("/nowhere"), 404, "/nowhere")
    assert_problem(await client.delete("/tests"), 405, "DELETE")
    assert_problem(await client.get("/tests/1"), 404)
    assert_problem(await client.get("/tests/20261121T031502Z-9f3c01ab"), 404, "unknown")
    assert_problem(await client.get("/tests/20261121T031502Z-9f3c01ab/events"), 404)
    assert_problem(await client.get("/tests/..%2f..%2fetc%2fpasswd/recording"), 404)
    assert_problem(await client.get("/valves/FV-999"), 404, "FV-999")
    assert_problem(await client.get("/tests?limit=0"), 422, "limit")
    assert_problem(await client.get("/tests?before=x"), 404)


async def test_the_list_is_paged_newest_first(client: httpx.AsyncClient, rig: FakeRig) -> None:
    rig.duration_s = 0.0
    ids = [(await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()["id"] for _ in range(5)]
    page = (await client.get("/tests", params={"limit": 2})).json()
    seen = [test["id"] for test in page["tests"]]
    while page["next"]:
        page = (await client.get(page["next"])).json()
        seen += [test["id"] for test in page["tests"]]
    assert seen == ids[::-1]


async def test_valves_show_their_last_result(client: httpx.AsyncClient, rig: FakeRig) -> None:
    run = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    valves = (await client.get("/valves")).json()["valves"]
    assert [valve["tag"] for valve in valves] == ["FV-101", "FV-102"]
    assert valves[0]["last_test"]["id"] == run["id"]
    assert valves[0]["busy_with"] is None
    assert valves[1]["last_test"] is None
    one = (await client.get("/valves/FV-101")).json()
    assert one["last_result"]["analysis"] == run["analysis"]
    assert one["nameplate"]["actuator"]["travel_m"] == 0.1016
    assert "triangle" in one["sequences"]
    assert (one["default_sequence"], one["default_sequence_reason"]) == ("multi_rate", "")
    rig.duration_s = LONG_S
    busy = (await client.post("/tests/run", json=RUN)).json()
    assert (await client.get("/valves/FV-101")).json()["busy_with"] == busy["id"]


CSV = "time_s,command_pa,position_m\n0,0,0\n0.1,1000,0.0001\n0.2,2000,0.0002\n"
NAMEPLATE = 'tag = "X"\n[actuator]\ndiaphragm_area_m2 = 0.06452\ntravel_m = 0.1016\n'


async def test_an_uploaded_recording_is_analysed_and_not_kept(client: httpx.AsyncClient, plant: Plant) -> None:
    as_json = json.dumps({"tag": "X", "actuator": {"diaphragm_area_m2": 0.06452, "travel_m": 0.1016}})
    for nameplate in (NAMEPLATE, as_json):
        files = {"recording": ("r.csv", CSV), "nameplate": ("n.toml", nameplate)}
        answer = await client.post("/recordings/analyze", files=files)
        assert answer.status_code == 200, answer.text
        assert answer.json()["recording"]["samples"] == 3
    answer = await client.post(
        "/recordings/analyze", files={"recording": ("r.csv", CSV)}, data={"nameplate": NAMEPLATE}
    )
    assert answer.status_code == 200
    assert list((plant.service.store / "uploads").iterdir()) == []


async def test_a_bad_upload_is_a_clear_problem(client: httpx.AsyncClient, plant: Plant) -> None:
    async def send(recording: str | None, nameplate: str | None, **more: str) -> httpx.Response:
        parts = {"recording": recording, "nameplate": nameplate, **more}
        return await client.post("/recordings/analyze", files={k: (k, v) for k, v in parts.items() if v is not None})

    back = CSV.replace("0.2,", "0.05,")
    assert_problem(await send(back, NAMEPLATE), 422, "increase")
    assert str(plant.service.store) not in (await send(back, NAMEPLATE)).text
    assert_problem(await send("", NAMEPLATE), 422, "recording")
    assert_problem(await send(CSV, NAMEPLATE.replace("travel_m", "travel")), 422, "travel")
    assert_problem(await send(CSV, "{"), 422, "JSON")
    assert_problem(await send(CSV, None), 422, "nameplate")
    assert_problem(await send(None, NAMEPLATE), 422, "recording")
    assert_problem(await send(CSV, NAMEPLATE, more="x"), 422, "more")
    assert_problem(await client.post("/recordings/analyze", json={}), 415, "multipart")


async def test_the_openapi_page_describes_every_route(client: httpx.AsyncClient) -> None:
    document = (await client.get("/openapi.json")).json()
    assert set(document["paths"]) >= {
        "/tests/run",
        "/tests",
        "/tests/{test_id}",
        "/tests/{test_id}/stop",
        "/tests/{test_id}/events",
        "/tests/{test_id}/recording",
        "/recordings/analyze",
        "/valves",
        "/valves/{tag}",
        "/healthz",
    }
    assert "Problem" in document["components"]["schemas"]
    assert (await client.get("/healthz")).json()["status"] == "ok"


async def test_an_analysis_that_fails_keeps_the_recording(
    client: httpx.AsyncClient, plant: Plant, analyst: FakeAnalyst
) -> None:
    analyst.let_go.clear()
    location = (await client.post("/tests/run", json=RUN)).headers["location"]
    recordings = plant.service.store / "recordings"
    deadline_s = time.monotonic() + 10.0
    while (await client.get(location)).json()["state"] != "analyzing":
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.01)
    assert (await client.get("/valves/FV-101")).json()["busy_with"] is None
    for path in list(recordings.iterdir()):
        path.rename(path.with_suffix(".moved"))
    analyst.let_go.set()
    body = await finished(client, location)
    assert body["state"] == "failed"
    assert "analysis failed" in body["error"]
    assert body["recording"]["sha256"]


async def test_shutting_down_stops_the_test_and_says_so(plant: Plant, rig: FakeRig, analyst: FakeAnalyst) -> None:
    rig.duration_s = LONG_S / 10
    async with running_service(plant, rig, analyst) as client:
        location = (await client.post("/tests/run", json=RUN)).headers["location"]
        await rig.moving.wait()
    async with running_service(plant, FakeRig(), analyst) as client:
        body = (await client.get(location)).json()
        assert body["state"] == "stopped"
        assert "shut down" in body["error"]
        assert not math.isnan(body["progress"])
        assert (await client.get(f"{location}/events")).text.count("event: end") == 1


async def test_a_slow_body_is_cut_while_stop_still_answers(plant: Plant, rig: FakeRig, analyst: FakeAnalyst) -> None:
    rig.duration_s = LONG_S / 5
    async with running_service(plant, rig, analyst) as client:
        location = (await client.post("/tests/run", json=RUN)).headers["location"]
        await rig.moving.wait()
        reader, writer = await asyncio.open_connection(client.base_url.host, client.base_url.port)
        writer.write(
            b"POST /tests/run HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 50\r\n\r\n{"
        )
        await writer.drain()
        watch = Stopwatch()
        assert (await client.post(f"{location}/stop")).json()["safe_confirmed"] is True
        assert watch.own_s < 1.0
        writer.close()
        await writer.wait_closed()
        del reader


async def test_plants_share_nothing_but_their_file(plant: Plant, rig: FakeRig, analyst: FakeAnalyst) -> None:
    elsewhere = replace(plant, service=replace(plant.service, store=plant.service.store.with_name("other")))
    async with running_service(plant, rig, analyst) as one, running_service(elsewhere, FakeRig(), analyst) as two:
        await one.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})
        assert (await two.get("/tests")).json()["tests"] == []
