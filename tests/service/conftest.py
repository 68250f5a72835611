from __future__ import annotations

import os
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import httpx
import pytest

from service.settings import Plant, load_plant
from tests.service.databases import postgresql_database
from tests.service.fake_rig import FakeAnalyst, FakeRig
from tests.service.running_service import running_service

PLANT = """\
[service]
store = "plant-data"
bind = "127.0.0.1"
port = 0

[[buses]]
name = "plc-1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = 5020

[[buses]]
name = "gauge-1"
kind = "serial_gauge"
serial_port = "/dev/null"
request = "?\\r"
pattern = '^(?P<value>[-+]?\\d+\\.\\d+)\\s*mm'

[[valves]]
tag = "FV-101"
safe_value_pa = 0.0
[valves.actuator]
diaphragm_area_m2 = 0.06452
travel_m = 0.1016
[valves.signal]
range_ma = [4.0, 20.0]
range_pa = [0.0, 82737.0]
[valves.limits]
pressure_pa = [0.0, 82737.0]
pressure_rate_pa_per_s = 30000.0
longest_test_s = 300.0
[valves.command]
bus = "plc-1"
device_id = 1
map = "reference"
[valves.acquisition]
mode = "captured"
period_s = 0.001

[[valves]]
tag = "FV-102"
safe_value_pa = "entry"
[valves.actuator]
diaphragm_area_m2 = 0.06452
travel_m = 0.1016
[valves.limits]
pressure_pa = [0.0, 82737.0]
pressure_rate_pa_per_s = 30000.0
longest_test_s = 300.0
[valves.command]
bus = "plc-1"
device_id = 2
map = "reference"
[valves.position]
bus = "gauge-1"
[valves.acquisition]
mode = "polled"
period_s = 0.01
[valves.watchdog]
timeout_s = 2.0
[valves.simulation]
parameter_set = "nominal"
"""


@pytest.fixture
def plant_text() -> str:
    return PLANT


@pytest.fixture
def quick_path(tmp_path: Path) -> Iterator[Path]:
    """Return a folder in memory where the machine has one: a busy disk is not what these tests measure."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.fixture
def plant_file(quick_path: Path) -> Path:
    path = quick_path / "plant.toml"
    path.write_text(PLANT, encoding="utf-8")
    return path


@pytest.fixture
def plant(plant_file: Path) -> Plant:
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
