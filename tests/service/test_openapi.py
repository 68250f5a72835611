"""The OpenAPI document and its page: every route has its group, its sentence and an example that the route takes."""

from __future__ import annotations

import re
import shlex
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute, iter_route_contexts
from pydantic import TypeAdapter

from service.config.plant import Plant
from service.routes.openapi import EXAMPLES, GROUPS, SAMPLES_KEY
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of


@pytest.fixture
def app(plant: Plant) -> FastAPI:
    return app_of(plant, rig=FakeRig(), analyst=FakeAnalyst())


def test_every_route_has_one_group_a_sentence_and_an_example(app: FastAPI) -> None:
    document = app.openapi()
    described = {one["name"]: one["description"] for one in document["tags"]}
    assert described == dict(GROUPS)
    operations = {f"{method} {path}": one for path, all_ in document["paths"].items() for method, one in all_.items()}
    assert operations.keys() == EXAMPLES.keys()
    used = set()
    for name, operation in operations.items():
        (group,) = operation["tags"]
        assert group in described, name
        used.add(group)
        assert len(operation["summary"].split()) >= 3, name
        assert not operation["summary"].endswith("."), name
        ((sample),) = operation[SAMPLES_KEY]
        assert sample["source"].startswith("curl "), name
    assert used == set(described), "a group without a route says nothing"
    sentences = [operation["summary"] for operation in operations.values()]
    assert len(set(sentences)) == len(sentences)


def _plain(path: str) -> str:
    """Return a route as the document names it, without what its parts may be."""
    return re.sub(r":[a-z]+\}", "}", path)


def test_every_example_is_taken_by_its_route(app: FastAPI) -> None:
    routes = {
        f"{method.lower()} {_plain(one.path or '')}": one.original_route
        for one in iter_route_contexts(app.routes)
        if isinstance(one.original_route, APIRoute)
        for method in one.original_route.methods or ()
    }
    for name, example in EXAMPLES.items():
        route = routes[name]
        assert isinstance(route, APIRoute)
        method, _, path = name.partition(" ")
        pattern = re.sub(r"\{[a-z_]+\}", "[^/]+", path)
        assert re.fullmatch(pattern, example.path), name
        known = {one.alias for one in route.dependant.query_params}
        for key, _value in httpx.QueryParams(example.query).multi_items():
            assert key in known, name
        assert (example.body is not None) == (route.body_field is not None), name
        if route.body_field is not None:
            model: Any = route.body_field.field_info.annotation
            TypeAdapter(model).validate_python(example.body)
        words = shlex.split(example.command(method))
        assert words[-1].startswith(f"$BREAKAWAY_URL{example.path}")


async def test_the_page_shows_every_group_and_route_and_loads_nothing(client: httpx.AsyncClient) -> None:
    page = (await client.get("/docs")).text
    for group in GROUPS:
        assert f'href="#{group}"' in page
        assert f'id="{group}"' in page
    assert page.count("<details>") == page.count("curl -s") == len(EXAMPLES)
    assert "<script" not in page
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)
