"""What routes are given of the service: each names its parts by their types, and the application has them all."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts

from service.config.plant import Plant
from service.http.given import Given, OfRequest, give, part_if_given, part_of
from service.runs.service import Runs
from service.store.store import Store
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.running_service import running_application


class Pump:
    def __init__(self, name: str) -> None:
        self.name = name


def _pump_house(name: str) -> FastAPI:
    app = FastAPI()

    @app.get("/pump")
    async def pump(pump: Given[Pump]) -> str:
        return pump.name

    give(app, {Pump: Pump(name)})
    return app


def _kinds(dependant: Dependant) -> Iterator[type]:
    for inner in dependant.dependencies:
        if isinstance(inner.call, OfRequest):
            yield inner.call.kind
        yield from _kinds(inner)


async def test_a_route_gets_the_part_of_its_own_application() -> None:
    for name in ("north", "south"):
        transport = httpx.ASGITransport(app=_pump_house(name))
        async with httpx.AsyncClient(transport=transport, base_url="http://plant") as client:
            assert (await client.get("/pump")).json() == name


async def test_what_a_route_is_given_is_no_parameter_of_its_request() -> None:
    (operation,) = _pump_house("north").openapi()["paths"]["/pump"].values()
    assert "parameters" not in operation
    assert "requestBody" not in operation


def test_parts_that_come_later_join_those_that_are_there() -> None:
    app = FastAPI()
    assert part_if_given(app, Pump) is None
    with pytest.raises(AssertionError, match="Pump"):
        part_of(app, Pump)
    give(app, {Pump: Pump("north")})
    give(app, {str: "a text"})
    assert (part_of(app, Pump).name, part_of(app, str)) == ("north", "a text")


async def test_every_part_that_a_route_names_is_there_when_the_service_has_started(plant: Plant) -> None:
    app = app_of(plant, rig=FakeRig(), analyst=FakeAnalyst())
    named = {kind for one in iter_route_contexts(app.routes) for kind in _kinds_of(one.original_route)}
    assert {Plant, Runs, Store} <= named
    async with running_application(app):
        missing = named - set(app.state.given)
    assert not missing, f"service/app.py gives no {sorted(kind.__name__ for kind in missing)}"


def _kinds_of(route: Any) -> Iterator[type]:
    if isinstance(route, APIRoute):
        yield from _kinds(route.dependant)
