"""Lists of a large plant: 5,000 valves, a test of each on 365 nights, on both stores, through the whole service."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import httpx
import numpy as np
from rich.table import Table
from sqlalchemy import Engine, text

from service.app import create_app
from service.health.figures import FIGURE_KINDS
from service.settings import Plant, load_plant
from service.store.database import open_database
from service.store.store import open_store
from tests.service.databases import postgresql_database, why_no_server
from tests.service.fake_rig import FakeAnalyst, FakeRig

VALVES: Final = 5000
NIGHTS: Final = 365
BUSES: Final = 50
REQUESTS: Final = 50
_LIMIT_S: Final = 0.3
_LIST_S: Final = 30.0  # longer no list is asked for, however busy the machine is
_FEWEST: Final = 5
_TOLD_NIGHTS: Final = 50
# As large as the analysis of a test with its pictures.
_CHANGE: Final = {
    "name": "friction_mean_n",
    "meaning": "friction, mean",
    "unit": "N",
    "was": 500.123456789,
    "now": 512.123456789,
    "change": 12.123456789,
    "ci95": [11.123456789, 13.123456789],
    "limit": 125.123456789,
    "kept": True,
}
_TREND: Final = {
    "name": "friction_mean_n",
    "per_day": 0.0123,
    "ci95": [0.0, 0.02],
    "tests": 60,
    "reaches_limit_at": None,
}
_HEALTH: Final = {
    "ne107": "N",
    "reasons": ["nothing"],
    "changes": 7 * [_CHANGE],
    "trends": 7 * [_TREND],
    "baseline": None,
}
_ANALYSIS: Final = {"schema": "breakaway/analysis/1", "health": _HEALTH, "fill": "x" * 60_000}
_COLUMNS: Final = (
    "id, valve, sequence, overrides, state, progress, created_at, started_at, motion_ended_at, finished_at, error, "
    "safe_confirmed, recording_file, recording_sha256, quality, software, requested_by, schedule"
)
_VALUES: Final = (
    "'{id}', '{tag}', 'multi_rate', '{{}}', 'completed', 1.0, {at}, {at}, {at}, {at}, '', {true}, '{id}.parquet', "
    "'" + "0" * 64 + "', '{quality}', 'breakaway 0.1.0', 'schedule nightly', 'nightly'"
)
_QUALITY: Final = json.dumps(
    {"samples": 60001, "gaps": 0, "achieved_rate_hz": 1000.0, "ended": "completed", "notes": []}
)


def _say(text: str) -> None:
    """Tell at once, as the table comes at the end."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def _plant_text(valves: int, database: str) -> str:
    line = f'database = "{database}"\n' if database else ""
    parts = [f'[service]\nstore = "data"\nport = 0\n{line}']
    parts += [
        f'[[buses]]\nname = "b{bus}"\nkind = "modbus_tcp"\nhost = "10.0.0.{bus + 1}"\nport = 502\n'
        for bus in range(BUSES)
    ]
    parts += [
        f'[[valves]]\ntag = "FV-{number:04d}"\nsafe_value_pa = 0.0\n'
        "[valves.actuator]\ndiaphragm_area_m2 = 0.06452\ntravel_m = 0.1016\n"
        "[valves.limits]\npressure_pa = [0.0, 82737.0]\npressure_rate_pa_per_s = 90000.0\nlongest_test_s = 300.0\n"
        f'[valves.command]\nbus = "b{number % BUSES}"\ndevice_id = {number // BUSES + 1}\nmap = "reference"\n'
        '[valves.acquisition]\nmode = "captured"\nperiod_s = 0.001\n'
        for number in range(valves)
    ]
    return "".join(parts)


def _fill(engine: Engine, valves: int, nights: int) -> None:
    """Write the tests night by night, as they would have come, by the database itself."""
    postgresql = engine.dialect.name == "postgresql"
    series = (
        f"generate_series(0, {valves - 1}) AS s(v)"
        if postgresql
        else f"(WITH RECURSIVE s(v) AS (SELECT 0 UNION ALL SELECT v + 1 FROM s WHERE v < {valves - 1}) SELECT v FROM s)"
    )
    tag = "'FV-' || " + ("lpad(v::text, 4, '0')" if postgresql else "printf('%04d', v)")
    began_s = time.monotonic()
    for night in range(nights):
        if night % _TOLD_NIGHTS == 0:
            _say(f"{engine.dialect.name}: {night} of {nights} nights written after {time.monotonic() - began_s:.0f} s")
        stamp = (
            "(timestamptz '2026-01-01' + interval '{0} days')" if postgresql else "datetime('2026-01-01', '+{0} days')"
        )
        values = _VALUES.format(
            id="@", tag="#", at=stamp.format(night), true="true" if postgresql else "1", quality=_QUALITY
        )
        number = (
            f"lpad(to_hex({night * valves} + v), 8, '0')" if postgresql else f"printf('%08x', {night * valves} + v)"
        )
        values = values.replace("'@.parquet'", f"'20260101T000000Z-' || {number} || '.parquet'")
        values = values.replace("'@'", f"'20260101T000000Z-' || {number}").replace("'#'", tag)
        with engine.begin() as connection:
            connection.exec_driver_sql(f"INSERT INTO tests ({_COLUMNS}) SELECT {values} FROM {series}")
    _finish(engine)


def _figures_statement(engine: Engine) -> str:
    """Return what writes the figures of every test: seven with their intervals, as a healthy valve's test has them."""
    true = "true" if engine.dialect.name == "postgresql" else "1"
    names = [f"{key}{end}" for key in list(FIGURE_KINDS)[:7] for end in ("", "_low", "_high")]
    values = ", ".join(f"{500 + place} + 0.001 * (number % 1000)" for place, _ in enumerate(names))
    return (
        "INSERT INTO figures (number, test_id, valve, conditions, at, ne107, verdict, causes, good, "
        f"{', '.join(names)}) "
        f"SELECT number, id, valve, sequence, created_at, 'N', 'none', '[]', {true}, {values} FROM tests"
    )


def _finish(engine: Engine) -> None:
    """Write what the service itself keeps beside the tests: the state of each valve and its last analysis."""
    health = json.dumps(_ANALYSIS["health"])
    with engine.begin() as connection:
        connection.execute(
            text(
                "INSERT INTO valve_states (valve, last_number, completed_number, health) "
                f"SELECT valve, max(number), max(number), '{health}' FROM tests GROUP BY valve".replace(":", r"\:")
            )
        )
        connection.execute(text(_figures_statement(engine)))
        connection.execute(
            text("INSERT INTO analyses (number, document) SELECT last_number, :document FROM valve_states"),
            {"document": json.dumps(_ANALYSIS)},
        )
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("ANALYZE"))


async def _latencies(plant: Plant, requests: int, seed: int) -> dict[str, list[float]]:
    """Seconds of each request, one after the other, through the application without a socket."""
    draw = random.Random(seed)
    tags = list(plant.valves)
    app = create_app(plant, store=open_store(plant.service), rig=FakeRig(), analyst=FakeAnalyst())
    found: dict[str, list[float]] = {}
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60.0) as client:
            first = (await client.get("/tests", params={"limit": 200})).json()
            paths: dict[str, Callable[[], str]] = {
                "GET /valves (200)": lambda: f"/valves?after={draw.choice(tags[: len(tags) // 2])}",
                "GET /valves/{tag}": lambda: f"/valves/{draw.choice(tags)}",
                "GET /valves/{tag}/trend (365)": lambda: f"/valves/{draw.choice(tags)}/trend?limit=365",
                "the tablet's valve": lambda: f"/ui/valves/{draw.choice(tags)}",
                "GET /tests (50)": lambda: "/tests",
                "GET /tests?valve= (50)": lambda: f"/tests?valve={draw.choice(tags)}",
                "GET /tests?before= (200)": lambda: f"/tests?limit=200&before={draw.choice(first['tests'])['id']}",
                "GET / (tablet's list)": lambda: "/",
            }
            for name, path in paths.items():
                ends_s = time.monotonic() + _LIST_S
                for index in range(requests + 2):
                    if index > _FEWEST and time.monotonic() > ends_s:
                        break
                    began_s = time.perf_counter()
                    answer = await client.get(path())
                    took_s = time.perf_counter() - began_s
                    assert answer.status_code == 200, (name, answer.text[:300])
                    if index >= 2:  # the first ones compile and fill caches
                        found.setdefault(name, []).append(took_s)
                median_s, p99_s = np.quantile(found[name], [0.5, 0.99])
                _say(f"{name}: median {1e3 * median_s:.0f} ms, p99 {1e3 * p99_s:.0f} ms of {len(found[name])}")
    return found


@contextlib.contextmanager
def _databases() -> Iterator[list[tuple[str, str]]]:
    with contextlib.ExitStack() as stack:
        databases = [("SQLite", "")]
        if not why_no_server():
            databases.append(("PostgreSQL", stack.enter_context(postgresql_database())))
        yield databases


def run(nights: int | None = None) -> Table:
    """Return the latencies of each list on each store; a number is that of nights."""
    count = NIGHTS if nights is None else nights
    table = Table("store", "tests", "request", "median, ms", "p99, ms", "limit, ms", title="lists of a large plant")
    with tempfile.TemporaryDirectory() as folder, _databases() as databases:
        for name, url in databases:
            place = Path(folder) / name
            place.mkdir()
            file = place / "plant.toml"
            file.write_text(_plant_text(VALVES, url), encoding="utf-8")
            plant = load_plant(file)
            (place / "data").mkdir()
            engine = open_database(url or f"sqlite:///{place / 'data' / 'breakaway.db'}")
            _fill(engine, VALVES, count)
            engine.dispose()
            for request, latencies in asyncio.run(_latencies(plant, REQUESTS, seed=5)).items():
                median_s, p99_s = np.quantile(latencies, [0.5, 0.99])
                table.add_row(
                    name,
                    f"{VALVES * count:,}",
                    request,
                    f"{1e3 * median_s:.0f}",
                    f"{1e3 * p99_s:.0f}",
                    f"{1e3 * _LIMIT_S:.0f}",
                )
    return table
