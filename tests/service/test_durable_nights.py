from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine, create_engine

from service.model.check import Check, CheckState
from service.store.run_table import RunTable
from service.store.schedule_run_table import ScheduleRunTable
from tests.service.nights import NIGHTLY, plant_text
from tests.support.databases import postgresql_database

ENDS: tuple[datetime, datetime] = (datetime(1970, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC))
GATEWAYS = (
    '[[gateways]]\nname = "g1"\nurl = "http://127.0.0.1:1"\n[[gateways]]\nname = "g2"\nurl = "http://127.0.0.1:2"\n'
)


@contextmanager
def _service(plant_file: Path, duration_s: float, *more: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.service.night_process", str(plant_file), str(duration_s), *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _until(engine: Engine, done: Callable[[list[Check]], bool], deadline_s: float = 120.0) -> dict[str, Check]:
    ends_s = time.monotonic() + deadline_s
    while True:
        checks = ScheduleRunTable(engine).between(*ENDS)
        if done(checks):
            return {check.valve: check for check in checks}
        assert time.monotonic() < ends_s, [(one.valve, one.state, one.reason) for one in checks]
        time.sleep(0.05)


def _ready(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "ready":
            return
    raise AssertionError("the process ended before it was ready")


@pytest.fixture
def plant_file(quick_path: Path, database_url: str) -> Path:
    path = quick_path / "plant.toml"
    line = "" if database_url.startswith("sqlite") else f'database = "{database_url}"'
    path.write_text(plant_text(service=line), encoding="utf-8")
    return path


def _database(plant_file: Path, database_url: str) -> Engine:
    if database_url.startswith("sqlite"):
        return create_engine(f"sqlite:///{plant_file.parent / 'plant-data' / 'breakaway.db'}")
    return create_engine(database_url)


@pytest.mark.parametrize("database_url", ["sqlite", pytest.param("postgresql", marks=pytest.mark.long)], indirect=True)
def test_a_killed_night_resumes_nothing_and_goes_on_with_what_waited(plant_file: Path, database_url: str) -> None:
    engine = _database(plant_file, database_url)
    with _service(plant_file, 30.0, "run") as first:
        _ready(first)
        begun = _until(engine, lambda checks: sum(check.test_id is not None for check in checks) == 2)
        first.send_signal(signal.SIGKILL)
        first.wait(120.0)
    assert begun["A2"].state is CheckState.QUEUED
    with _service(plant_file, 0.05) as second:
        _ready(second)
        checks = _until(engine, lambda found: all(check.state.ended for check in found))
        time.sleep(1.5)  # three polls of the queue: a job that is taken up again would be by now
        second.send_signal(signal.SIGTERM)
        assert second.wait(120.0) == 0
    assert {tag: check.state.value for tag, check in checks.items()} == {
        "A1": "interrupted",
        "A2": "completed",
        "B1": "interrupted",
    }
    tests = [run.valve for run in RunTable(engine).newest(20)]
    assert sorted(tests) == ["A1", "A2", "B1"]
    assert checks["A1"].test_id == begun["A1"].test_id
    engine.dispose()


def test_two_gateways_share_a_database_and_no_bus(quick_path: Path) -> None:
    with postgresql_database() as url:
        files = {}
        for gateway in ("g1", "g2"):
            (quick_path / gateway).mkdir()
            files[gateway] = quick_path / gateway / "plant.toml"
            line = f'database = "{url}"\ngateway = "{gateway}"'
            files[gateway].write_text(plant_text(NIGHTLY + GATEWAYS, line, ("g1", "g2")), encoding="utf-8")
        engine = create_engine(url)
        with _service(files["g1"], 0.5, "run") as one, _service(files["g2"], 0.5, "run") as other:
            _ready(one)
            _ready(other)
            checks = _until(engine, lambda found: len(found) == 3 and all(check.state.ended for check in found))
        assert {check.state for check in checks.values()} == {CheckState.COMPLETED}
        assert {tag: check.gateway for tag, check in checks.items()} == {"A1": "g1", "A2": "g1", "B1": "g2"}
        runs = {run.valve: run for run in RunTable(engine).newest(20)}
        assert {tag: run.gateway for tag, run in runs.items()} == {"A1": "g1", "A2": "g1", "B1": "g2"}
        recordings = (quick_path / "g2" / "plant-data" / "recordings").iterdir()
        assert [path.name for path in recordings] == [f"{runs['B1'].id}.parquet"]
        engine.dispose()
