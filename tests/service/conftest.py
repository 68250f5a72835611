from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import httpx
import pytest

from service.config.plant import Plant
from service.config.settings import load_plant
from tests.support.databases import migrate_by_copy, postgresql_database
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.running_service import running_service

GAUGE = """\
[[buses]]
name = "gauge-1"
kind = "serial_gauge"
serial_port = "/dev/null"
request = "?\\r"
pattern = '^(?P<value>[-+]?\\d+\\.\\d+)\\s*mm'
"""
SEEN_BY_GAUGE = """\
[valves.position]
bus = "gauge-1"
[valves.simulation]
parameter_set = "nominal"
"""
PLANT = (
    service_text('bind = "127.0.0.1"')
    + bus_text("plc-1", 5020)
    + GAUGE
    + valve_text("FV-101", "plc-1")
    + valve_text(
        "FV-102",
        "plc-1",
        2,
        safe='"entry"',
        signal=False,
        mode="polled",
        period_s=0.01,
        watchdog_s=2.0,
        more=SEEN_BY_GAUGE,
    )
)


@pytest.fixture(autouse=True)
def _stores_are_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.store.database.migrate", migrate_by_copy)


@pytest.fixture
def plant_text() -> str:
    return PLANT


@pytest.fixture
def plant_file(quick_path: Path) -> Path:
    path = quick_path / "plant.toml"
    path.write_text(PLANT, encoding="utf-8")
    return path


@pytest.fixture
def plant(plant_file: Path) -> Plant:
    return load_plant(plant_file)


@pytest.fixture
def watched_plant(plant_file: Path, plant_text: str) -> Plant:
    """Return the plant with its first valve watched from 22:00 to 05:00 UTC."""
    watch = '[valves.watch]\nfrom = "22:00"\nuntil = "05:00"\n'
    text = plant_text.replace(
        '[valves.acquisition]\nmode = "captured"', f'{watch}[valves.acquisition]\nmode = "captured"'
    )
    plant_file.write_text(text.replace("[service]\n", '[service]\nzone = "UTC"\n'), encoding="utf-8")
    return load_plant(plant_file)


@pytest.fixture
def rig() -> FakeRig:
    return FakeRig()


@pytest.fixture
def analyst() -> FakeAnalyst:
    return FakeAnalyst()


@pytest.fixture
async def client(plant: Plant, rig: FakeRig, analyst: FakeAnalyst) -> AsyncIterator[httpx.AsyncClient]:
    """Return a client of a service that drives ``rig`` and asks ``analyst``."""
    async with running_service(plant, rig, analyst) as client:
        yield client


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, quick_path: Path) -> Iterator[str]:
    """Return the address of an empty database, of each kind in turn; PostgreSQL is skipped where no server answers."""
    if request.param == "sqlite":
        yield f"sqlite:///{quick_path / 'breakaway.db'}"
        return
    with postgresql_database() as url:
        yield url
