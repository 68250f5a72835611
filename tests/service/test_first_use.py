"""What the first request of its kind would make on the event loop is made before the service listens."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from typing import Any

import httpx
import jinja2
import pytest

from service.config.plant import Plant
from service.routes import openapi as openapi_module
from service.server import server
from service.server.first_use import use_once
from service.tablet import rendering
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of


def _too_late(*_: Any, **__: Any) -> None:
    raise AssertionError("made at the first request")


async def test_pages_and_document_are_made_before_the_first_request(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = app_of(plant, rig=FakeRig(), analyst=FakeAnalyst())
    rendering.environment.cache_clear()
    await asyncio.to_thread(use_once, app)
    monkeypatch.setattr(jinja2.Environment, "compile", _too_late)
    monkeypatch.setattr(openapi_module, "get_openapi", _too_late)
    carried = httpx.ASGITransport(app=app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=carried, base_url=f"http://127.0.0.1:{plant.service.port}") as client,
    ):
        for path in ("/", "/ui/valves/FV-101", "/ui/valves/FV-101/start", "/ui/night", "/openapi.json", "/docs"):
            answer = await client.get(path)
            assert answer.status_code == 200, (path, answer.text)


_LIVE_VIEW = """
import sys
from fastapi import FastAPI
from service.server.first_use import use_once
before = "anyio._backends._asyncio" in sys.modules
use_once(FastAPI())
print(before, "anyio._backends._asyncio" in sys.modules)
"""


def test_what_carries_a_live_view_is_loaded_before_the_first_one() -> None:
    said = subprocess.run([sys.executable, "-c", _LIVE_VIEW], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["False", "True"]


def test_a_service_that_starts_waits_for_nothing_that_draws_or_estimates() -> None:
    """Other processes do both; loading that took as long as all the rest."""
    heavy = ("numba", "matplotlib", "typst", "scipy.stats", "scipy.optimize", "scipy.signal")
    loaded = f"import sys, service.app; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_the_service_makes_them_before_it_listens_to_anybody(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(server, "use_once", lambda _app: made.append("made"))
    monkeypatch.setattr(server._Server, "run", lambda *_, **__: made.append("serves"))
    monkeypatch.setattr(sys, "setswitchinterval", lambda _seconds: None)
    server.serve_plant(plant)
    assert made == ["made", "serves"]
