"""Whatever is sent to any route of the OpenAPI document, the service never fails and answers as the document says."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final
from urllib.parse import quote

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.config.settings import load_plant
from tests.service.conftest import PLANT
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service

EXAMPLES: Final = 400
PROBLEM: Final = "application/problem+json"

any_text = st.text(max_size=20)
any_json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | any_text,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(any_text, inner, max_size=4),
    max_leaves=10,
)
header_text = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=60).map(str.strip)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """Serve a plant from another thread: hypothesis draws from this one."""
    file = tmp_path_factory.mktemp("any") / "plant.toml"
    file.write_text(PLANT, encoding="utf-8")
    listening: Future[str] = Future()
    ended = threading.Event()

    async def serve() -> None:
        async with running_service(load_plant(file), FakeRig(0.0), FakeAnalyst()) as client:
            listening.set_result(str(client.base_url))
            await asyncio.to_thread(ended.wait)

    with ThreadPoolExecutor(1) as pool:
        serving = pool.submit(asyncio.run, serve())
        try:
            with httpx.Client(base_url=listening.result(30.0), timeout=20.0) as client:
                for tag in ("FV-101", "FV-102"):
                    client.post("/tests/run", json={"valve": tag}, headers={"Prefer": "wait=10"})
                yield client
        finally:
            ended.set()
        serving.result(30.0)


@pytest.fixture(scope="module")
def document(service: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = service.get("/openapi.json").json()
    return found


@pytest.fixture(scope="module")
def known(service: httpx.Client) -> list[str]:
    return [test["id"] for test in service.get("/tests").json()["tests"]] + ["FV-101", "FV-102"]


def values(schema: Mapping[str, Any], document: Mapping[str, Any]) -> st.SearchStrategy[Any]:
    """Values that an OpenAPI schema allows, as far as the service's schemas go."""
    if "$ref" in schema:
        return values(document["components"]["schemas"][schema["$ref"].rpartition("/")[2]], document)
    if "anyOf" in schema:
        return st.one_of(*(values(one, document) for one in schema["anyOf"]))
    examples = st.sampled_from(schema["examples"]) if schema.get("examples") else st.nothing()
    match schema.get("type"):
        case "string":
            return examples | st.text(min_size=schema.get("minLength", 0), max_size=schema.get("maxLength", 20))
        case "integer":
            return st.integers(schema.get("minimum"), schema.get("maximum"))
        case "null":
            return st.none()
        case "object" if "properties" in schema:
            members = {name: values(one, document) for name, one in schema["properties"].items()}
            required = {name: members.pop(name) for name in schema.get("required", [])}
            return st.fixed_dictionaries(required, optional=members)
        case "object":
            return examples | st.dictionaries(any_text, any_json, max_size=4)
        case _:
            return any_json


def path_value(data: st.DataObject, known: list[str]) -> str:
    """A part of a path: the id of a test, a tag, or anything else. What is drawn must not depend on the ids."""
    number = data.draw(st.integers(0, 2 * len(known) - 1))
    other = data.draw(any_text | st.sampled_from(["..", "../x", ".", "%", "\0", ""]))
    return known[number] if number < len(known) else other


def body(data: st.DataObject, operation: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a request: what the document describes, mostly; now and then something else."""
    content = operation.get("requestBody", {}).get("content", {})
    if not content and data.draw(st.booleans()):
        return {}
    if "multipart/form-data" in content:
        csv = st.just("time_s,command_pa,position_m\n0,0,0\n1,1,1\n") | any_text.map("time_s,{}\n1,2\n".format)
        plate = st.just('tag = "X"\n[actuator]\ntravel_m = 0.1\n') | any_text | any_json.map(json.dumps)
        parts = data.draw(
            st.fixed_dictionaries(
                {}, optional={"recording": csv | st.binary(max_size=50), "nameplate": plate, "more": any_text}
            )
        )
        return {"files": {name: (name, part) for name, part in parts.items()}} if parts else {}
    schema = content.get("application/json", {}).get("schema", {})
    text = data.draw(
        values(schema, document).map(json.dumps) | any_json.map(json.dumps) | st.text(max_size=30) | st.just("[" * 5000)
    )
    kind = data.draw(st.sampled_from(["application/json"] * 4 + ["text/plain", "application/xml", ""]))
    return {"content": text.encode("utf-8", "surrogatepass"), "headers": {"Content-Type": kind}}


@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(data=st.data())
def test_no_request_makes_the_service_fail(
    service: httpx.Client, document: dict[str, Any], known: list[str], data: st.DataObject
) -> None:
    path = data.draw(st.sampled_from(sorted(document["paths"])))
    method = data.draw(st.sampled_from(sorted(document["paths"][path])))
    operation = document["paths"][path][method]
    url, query, same_route = path, "", True
    headers: dict[str, str] = {}
    for parameter in operation.get("parameters", []):
        name, schema = parameter["name"], parameter["schema"]
        if parameter["in"] == "path":
            part = path_value(data, known)
            same_route = part not in ("", ".", "..") and "/" not in part
            url = url.replace(f"{{{name}}}", quote(part, safe="", errors="surrogatepass"))
        elif data.draw(st.booleans()):
            if parameter["in"] == "query":
                value = str(data.draw(values(schema, document) | any_text))
                query += f"&{name}={quote(value, safe='', errors='surrogatepass')}"
            else:
                headers[name] = data.draw(header_text)
    for name in ("Prefer", "Accept", "Last-Event-ID"):
        if data.draw(st.booleans()):
            headers[name] = data.draw(st.sampled_from(["wait=1", "*/*", "3"]) | header_text)
    arguments = body(data, operation, document)
    headers |= arguments.pop("headers", {})
    answer = service.request(method, f"{url}?{query}", headers=headers, **arguments)
    assert_as_documented(answer, operation, same_route)


def assert_as_documented(answer: httpx.Response, operation: Mapping[str, Any], same_route: bool) -> None:
    """Fail unless the answer is one that the document lists, in the form that it lists."""
    assert answer.status_code < 500, answer.text
    kind = answer.headers.get("content-type", "").partition(";")[0]
    if answer.is_error:
        assert kind == PROBLEM
        problem = answer.json()
        assert problem["status"] == answer.status_code
        assert problem["detail"]
    if same_route:
        assert str(answer.status_code) in operation["responses"]
    if answer.is_success and kind == "application/json":
        assert_finite(answer.json())


def assert_finite(value: Any) -> None:
    """Fail where something in a JSON document is no finite number."""
    if isinstance(value, float):
        assert math.isfinite(value)
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        assert_finite(inner)
