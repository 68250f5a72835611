"""How the service speaks HTTP: types of bodies, methods, heads, and pages that need no other host."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import httpx
import pytest

from service.config.plant import Plant
from service.config.settings import load_plant
from tests.support.fake_rig import FakeRig
from tests.support.problem import assert_problem

RUN = {"valve": "FV-101"}
SLASHED = "FV-101 A/B&C"


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig(0.0)


@pytest.fixture
def plant(plant_file: Path, plant_text: str) -> Plant:
    plant_file.write_text(plant_text.replace('"FV-102"', f'"{SLASHED}"'), encoding="utf-8")
    return load_plant(plant_file)


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "application/jsonp", ""])
async def test_a_body_of_another_type_is_refused_as_such(client: httpx.AsyncClient, rig: FakeRig, kind: str) -> None:
    answer = await client.post("/tests/run", content='{"valve": "FV-101"}', headers={"Content-Type": kind})
    assert_problem(answer, 415, "application/json")
    assert rig.orders == []


async def test_a_body_without_any_type_is_refused_as_such(client: httpx.AsyncClient) -> None:
    assert_problem(await client.post("/tests/run", content='{"valve": "FV-101"}'), 415, "application/json")
    assert_problem(await client.post("/tests/run"), 422, "body")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ('{"valve": "FV-102", "valve": "FV-101"}', "'valve' stands in it twice"),
        ('{"valve": "FV-101", "overrides": {"cycles": 1, "cycles": 2}}', "'cycles' stands in it twice"),
        ('{"valve": "FV-101", "overrides": {"period_s": -Infinity}}', "-Infinity is no number"),
        ('{"valve": "FV-101", "overrides": {"cycles": ' + "9" * 30 + "}}", "30 digits"),
        ("[" * 30_000 + "]" * 30_000, "nested too deeply"),
        ('{"valve": "FV-101"', "delimiter"),
    ],
)
async def test_json_that_is_ambiguous_or_broken_is_refused_with_its_reason(
    client: httpx.AsyncClient, rig: FakeRig, body: str, reason: str
) -> None:
    answer = await client.post("/tests/run", content=body, headers={"Content-Type": "application/json; charset=utf-8"})
    assert_problem(answer, 422, reason, "correct the request")
    assert rig.orders == []


async def test_an_empty_or_overlong_idempotency_key_is_refused(client: httpx.AsyncClient, rig: FakeRig) -> None:
    for key in ("", "k" * 256):
        assert_problem(await client.post("/tests/run", json=RUN, headers={"Idempotency-Key": key}), 422, "idempotency")
    assert rig.orders == []


async def test_head_is_answered_as_get_without_a_body(client: httpx.AsyncClient) -> None:
    test = (await client.post("/tests/run", json=RUN, headers={"Prefer": "wait=10"})).json()
    # A completed test's stem may not have been looked at yet, and the answers in which it is told would change.
    async with asyncio.timeout(10.0):
        while (await client.get(test["href"])).json()["stands"]["verdict"] == "moving":  # noqa: ASYNC110  - from outside
            await asyncio.sleep(0.01)
    for path in ("/healthz", "/tests", test["href"], test["recording"]["href"], "/valves", "/valves/FV-101", "/docs"):
        head, get = await client.head(path), await client.get(path)
        assert head.status_code == get.status_code == 200, path
        assert head.headers["content-length"] == str(len(get.content))
        assert head.content == b""
    assert (await client.head("/nowhere")).status_code == 404
    assert (await client.head("/tests/run")).status_code == 404
    assert (await client.head(f"{test['href']}/events")).status_code == 405


async def test_a_refused_method_says_which_are_possible(client: httpx.AsyncClient) -> None:
    answer = await client.request("OPTIONS", "/tests")
    assert_problem(answer, 405, "OPTIONS", "/docs")
    assert answer.headers["allow"] == "GET, HEAD"
    assert (await client.delete("/tests/run")).headers["allow"] == "POST"


async def test_the_page_of_routes_lists_them_all_and_needs_no_other_host(client: httpx.AsyncClient) -> None:
    page = await client.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    for path in (await client.get("/openapi.json")).json()["paths"]:
        assert f"<code>{path}</code>" in page.text
    assert not re.search(r"(?:src|href)=\"(?:https?:)?//|@import|url\(", page.text)
    assert "<script" not in page.text
    assert_problem(await client.get("/redoc"), 404)


async def test_a_torn_form_is_refused_in_a_sentence(client: httpx.AsyncClient) -> None:
    for kind in ("multipart/form-data", "multipart/form-data; boundary=x"):
        answer = await client.post("/recordings/analyze", content=b"x", headers={"Content-Type": kind})
        assert_problem(answer, 422, "multipart/form-data", "send the parts recording and nameplate")


async def test_links_to_an_unusual_tag_can_be_followed(client: httpx.AsyncClient) -> None:
    for _ in range(3):
        await client.post("/tests/run", json={"valve": SLASHED}, headers={"Prefer": "wait=10"})
    page = (await client.get("/tests", params={"valve": SLASHED, "limit": 2})).json()
    rest = (await client.get(page["next"])).json()
    assert [len(page["tests"]), len(rest["tests"]), rest["next"]] == [2, 1, None]
    href = next(valve["href"] for valve in (await client.get("/valves")).json()["valves"] if valve["tag"] == SLASHED)
    assert (await client.get(href)).json()["tag"] == SLASHED
    assert_problem(await client.get("/valves/"), 404, "unknown")
