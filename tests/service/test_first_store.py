"""A store of the first schema, with what its code wrote into it: opened in place, migrated, and served."""

from __future__ import annotations

import asyncio
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import MetaData, Table, insert, make_url

from service.analysis.analysis import analyze_recordings
from service.config.plant import DatabaseAddress, Plant
from service.config.settings import load_plant
from service.routes.recording_formats import PARQUET
from service.store.database import _config, _engine, newest_revision
from tests.service.access.signed_in import body_of
from tests.support.databases import postgresql_database
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.running_service import running_service
from valve.nameplate import Nameplate
from valve.recording_files import read_recording

FIRST = Path(__file__).parents[1] / "data" / "stores" / "first"
ROWS = json.loads((FIRST / "tests.json").read_text(encoding="utf-8"))
FRICTION_N = ROWS[0]["analysis"]["signature"]["friction_mean_n"]
_INSTANTS = ("created_at", "started_at", "motion_ended_at", "finished_at")


class Analysing(FakeAnalyst):
    """Analyses a recording as this version does."""

    async def analyze(self, recording_path: Path, nameplate: Nameplate, *_: Any, **_more: Any) -> dict[str, Any]:
        recording = await asyncio.to_thread(read_recording, recording_path, nameplate)
        return await asyncio.to_thread(analyze_recordings, [recording], nameplate)


def _row(stored: dict[str, Any]) -> dict[str, Any]:
    instants = {name: None if stored[name] is None else datetime.fromisoformat(stored[name]) for name in _INSTANTS}
    aware = {name: None if at is None else at.replace(tzinfo=UTC) for name, at in instants.items()}
    return {**stored, **aware, "safe_confirmed": bool(stored["safe_confirmed"])}


def _write_first_store(folder: Path, url: str) -> None:
    """Make the first schema by its migration, and put rows and recordings in it."""
    folder.mkdir()
    engine = _engine(make_url(url))
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0001")
        table = Table("tests", MetaData(), autoload_with=connection)
        assert list(ROWS[0]) == [column.name for column in table.columns]
        connection.execute(insert(table), [_row(stored) for stored in ROWS])
        if engine.dialect.name == "postgresql":
            connection.exec_driver_sql("SELECT setval(pg_get_serial_sequence('tests', 'number'), 3)")
    engine.dispose()
    shutil.copytree(FIRST / "recordings", folder / "recordings")


@pytest.fixture
def plant_of(quick_path: Path) -> Iterator[Callable[[bool], Plant]]:
    """Return a plant of today whose store the first version wrote, on SQLite or PostgreSQL."""
    with ExitStack() as databases:

        def write(postgresql: bool) -> Plant:
            range_pa = (20000.0, 100000.0)
            valve = valve_text("FV-101", "plc-1", actuator=(0.155, 0.06), pressure_pa=range_pa, safe="20000.0")
            file = quick_path / "plant.toml"
            file.write_text(service_text() + bus_text("plc-1", 5020) + valve, encoding="utf-8")
            plant = load_plant(file)
            url = f"sqlite:///{plant.service.store / 'breakaway.db'}"
            if postgresql:
                url = databases.enter_context(postgresql_database())
                plant = replace(plant, service=replace(plant.service, database=DatabaseAddress(url)))
            _write_first_store(plant.service.store, url)
            return plant

        yield write


@pytest.mark.parametrize("postgresql", [False, True])
async def test_a_store_of_the_first_schema_is_migrated_in_place_and_served(
    plant_of: Callable[[bool], Plant], postgresql: bool
) -> None:
    plant = plant_of(postgresql)
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        tests = body_of(await client.get("/tests"))["tests"]
        assert [(one["id"], one["state"]) for one in tests] == [(one["id"], one["state"]) for one in reversed(ROWS)]
        for stored in ROWS[:2]:
            whole = body_of(await client.get(f"/tests/{stored['id']}"))
            assert whole["analysis"] == stored["analysis"], "what was found then is told as it was"
            assert (whole["safe_confirmed"], whole["commanded"]) == (True, True)
            assert whole["created_at"].startswith(stored["created_at"][:10])
            raw = await client.get(f"/tests/{stored['id']}/recording", headers={"Accept": PARQUET})
            assert hashlib.sha256(raw.content).hexdigest() == stored["recording_sha256"]
            rows = (await client.get(f"/tests/{stored['id']}/recording")).text.splitlines()
            assert len(rows) == 1 + stored["analysis"]["recording"]["samples"]
            report = await client.get(f"/tests/{stored['id']}/report", headers={"Accept": "text/html"})
            friction = f"{stored['analysis']['signature']['friction_mean_n']:.0f} N"
            assert (report.status_code, f">{friction}<" in report.text) == (200, True)
            printed = await client.get(f"/tests/{stored['id']}/report")
            assert printed.content.startswith(b"%PDF")
            assert (await client.get(f"/ui/tests/{stored['id']}")).status_code == 200
        valve = body_of(await client.get("/valves/FV-101"))
        assert valve["last_test"]["id"] == ROWS[2]["id"]
        assert body_of(await client.get("/valves/FV-101/trend"))["trends"] == [], "the next test begins the trend"
        assert (await client.get("/ui/valves/FV-101")).status_code == 200
        assert "FV-101" in (await client.get("/")).text
        for cut_short in ("/ui", "/ui/"):
            assert (await client.get(cut_short)).headers["location"] == "/"
    engine = _engine(make_url(plant.service.database.with_password() if plant.service.database else _sqlite(plant)))
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar_one() == newest_revision()
    engine.dispose()


def _sqlite(plant: Plant) -> str:
    return f"sqlite:///{plant.service.store / 'breakaway.db'}"


async def test_what_the_first_version_recorded_is_analysed_anew_and_begins_the_trend(
    plant_of: Callable[[bool], Plant],
) -> None:
    async with running_service(plant_of(False), FakeRig(), Analysing()) as client:
        failed = await client.post("/tests/run", json={"valve": "FV-101"})
        assert failed.status_code == 423, "nobody has looked at the valve since its safe state was not confirmed"
        for stored in ROWS[:2]:
            begun = await client.post(f"/tests/{stored['id']}/analyze")
            assert begun.status_code == 202, begun.text
            await client.get(f"/tests/{stored['id']}/events")  # it ends with the analysis
            analysis = body_of(await client.get(f"/tests/{stored['id']}"))["analysis"]
            assert {one["method"] for one in analysis["estimates"]} > {"regression", "garcia"}
            assert analysis["signature"]["friction_mean_n"] == pytest.approx(FRICTION_N, rel=0.05)
        trends = {one["name"]: one["points"] for one in body_of(await client.get("/valves/FV-101/trend"))["trends"]}
        assert [point["test"] for point in trends["friction_mean_n"]] == [stored["id"] for stored in ROWS[:2]]
        assert [point["at"][:10] for point in trends["friction_mean_n"]] == ["2026-03-02", "2026-03-09"]
        said = await client.post(f"/tests/{ROWS[2]['id']}/acknowledge", json={"note": "it stood closed"})
        assert said.status_code == 200, said.text
        assert body_of(await client.get(f"/tests/{ROWS[2]['id']}"))["acknowledged_at"] is not None
