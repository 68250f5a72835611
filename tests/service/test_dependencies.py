"""What FastAPI calls before a route."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts

from service.config.settings import load_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of


def _called(dependant: Dependant) -> Iterator[Any]:
    for inner in dependant.dependencies:
        yield inner.call
        yield from _called(inner)


def test_nothing_that_comes_before_a_route_needs_a_thread(plant_file: Path) -> None:
    app = app_of(load_plant(plant_file), rig=FakeRig(), analyst=FakeAnalyst())
    called = {
        call
        for route in iter_route_contexts(app.routes)
        if isinstance(route.original_route, APIRoute)
        for call in _called(route.dependant)
    }
    assert len(called) > 3
    in_threads = [
        call
        for call in called
        if not inspect.iscoroutinefunction(call) and not inspect.iscoroutinefunction(type(call).__call__)
    ]
    assert in_threads == []
