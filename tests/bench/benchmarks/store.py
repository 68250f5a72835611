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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import httpx
import numpy as np
from rich.table import Table
from sqlalchemy import JSON, Connection, Engine, bindparam, text

from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.health_figures import FIGURE_KINDS
from service.server.server import settle_memory
from service.store.database import open_database
from service.store.schema_health import FIGURES
from service.store.schema_tests import TESTS
from service.store.store import open_store
from tests.support.databases import postgresql_database, why_no_server
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.plants import bus_text, service_text, valve_text

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
    "{id}, {tag}, 'multi_rate', '{{}}', 'completed', 1.0, {at}, {at}, {at}, {at}, '', {true}, {id} || '.parquet', "
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
    parts = [service_text(f'database = "{database}"' if database else "", store="data")]
    parts += [bus_text(f"b{bus}", 5020 + bus) for bus in range(BUSES)]
    parts += [
        valve_text(f"FV-{number:04d}", f"b{number % BUSES}", number // BUSES + 1, signal=False, rate_pa_per_s=90000.0)
        for number in range(valves)
    ]
    return "".join(parts)


def _fill(engine: Engine, valves: int, nights: int) -> None:
    """Write the tests night by night, as they would have come, by the database itself; its indexes come last."""
    postgresql = engine.dialect.name == "postgresql"
    began_s = time.monotonic()
    indexes = sorted((*TESTS.indexes, *FIGURES.indexes), key=lambda index: str(index.name))
    for index in indexes:
        index.drop(engine)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        if not postgresql:  # nothing of it must survive a power cut
            connection.exec_driver_sql("PRAGMA synchronous=OFF")
        for night in range(nights):
            if night % _TOLD_NIGHTS == 0:
                took_s = time.monotonic() - began_s
                _say(f"{engine.dialect.name}: {night} of {nights} nights written after {took_s:.0f} s")
            connection.exec_driver_sql(_night_statement(valves, night, postgresql=postgresql))
            numbers = {"above": night * valves, "last": (night + 1) * valves}
            connection.execute(text(_figures_statement(postgresql=postgresql)), numbers)
        for index in indexes:
            index.create(connection)
        _finish(connection)
        connection.execute(text("ANALYZE"))


def _night_statement(valves: int, night: int, *, postgresql: bool) -> str:
    """Return what writes a test of every valve."""
    if postgresql:
        series, tag = f"generate_series(0, {valves - 1}) AS s(v)", "lpad(v::text, 4, '0')"
        at = f"(timestamptz '2026-01-01' + interval '{night} days')"
        number = f"lpad(to_hex({night * valves} + v), 8, '0')"
    else:
        rows = f"SELECT 0 UNION ALL SELECT v + 1 FROM s WHERE v < {valves - 1}"
        series, tag = f"(WITH RECURSIVE s(v) AS ({rows}) SELECT v FROM s)", "printf('%04d', v)"
        at = f"strftime('%Y-%m-%d %H:%M:%f', '2026-01-01', '+{night} days')"
        number = f"printf('%08x', {night * valves} + v)"
    values = _VALUES.format(
        id=f"'20260101T000000Z-' || {number}",
        tag=f"'FV-' || {tag}",
        at=at,
        true="true" if postgresql else "1",
        quality=_QUALITY,
    )
    return f"INSERT INTO tests ({_COLUMNS}) SELECT {values} FROM {series}"


def _figures_statement(*, postgresql: bool) -> str:
    """Return what writes the figures of tests: seven with their intervals, as a healthy valve's test has them."""
    true = "true" if postgresql else "1"
    names = [f"{key}{end}" for key in list(FIGURE_KINDS)[:7] for end in ("", "_low", "_high")]
    values = ", ".join(f"{500 + place} + 0.001 * (number % 1000)" for place, _ in enumerate(names))
    return (
        "INSERT INTO figures (number, test_id, valve, conditions, at, ne107, verdict, causes, good, "
        f"{', '.join(names)}) "
        f"SELECT number, id, valve, sequence, created_at, 'N', 'none', '[]', {true}, {values} FROM tests "
        "WHERE number > :above AND number <= :last"
    )


def _finish(connection: Connection) -> None:
    """Write what the service itself keeps beside the tests: how each valve stands, its health, its last analysis."""
    connection.execute(
        text(
            "INSERT INTO valve_states "
            "(valve, last_number, completed_number, state, safe_confirmed, last_at, ne107, completed_at) "
            "SELECT t.valve, t.number, t.number, t.state, t.safe_confirmed, t.created_at, 'N', t.created_at "
            "FROM tests t JOIN (SELECT valve, max(number) AS last FROM tests GROUP BY valve) l ON t.number = l.last"
        )
    )
    documents = {
        "valve_healths (valve, health)": ("valve", _HEALTH),
        "analyses (number, document)": ("last_number", _ANALYSIS),
    }
    for into, (key, document) in documents.items():
        statement = text(f"INSERT INTO {into} SELECT {key}, :document FROM valve_states")
        connection.execute(statement.bindparams(bindparam("document", document, JSON)))


@dataclass
class Took:
    """What the requests for one list took, s: on the wall clock, and of this process's processor time."""

    wall_s: list[float] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)

    def shown(self) -> tuple[str, ...]:
        """Return medians and 99 % quantiles, ms."""
        both = [np.quantile(values, [0.5, 0.99]) for values in (self.wall_s, self.processor_s)]
        return tuple(f"{1e3 * value:.0f}" for pair in both for value in pair)


def _lists(tags: list[str], tests: list[str], seed: int) -> dict[str, Callable[[], str]]:
    """Return what is asked for: each list by its name, another valve or test each time."""
    draw = random.Random(seed)
    early = tags[: len(tags) // 2]
    return {
        "GET /valves (200)": lambda: f"/valves?after={draw.choice(early)}",
        "GET /valves (500)": lambda: f"/valves?limit=500&after={draw.choice(early)}",
        "GET /valves/{tag}": lambda: f"/valves/{draw.choice(tags)}",
        "GET /valves/{tag}/trend (365)": lambda: f"/valves/{draw.choice(tags)}/trend?limit=365",
        "the tablet's valve": lambda: f"/ui/valves/{draw.choice(tags)}",
        "GET /tests (50)": lambda: "/tests",
        "GET /tests?valve= (50)": lambda: f"/tests?valve={draw.choice(tags)}",
        "GET /tests?before= (200)": lambda: f"/tests?limit=200&before={draw.choice(tests)}",
        "GET / (tablet's list)": lambda: "/",
        "GET /metrics (no list)": lambda: "/metrics",
    }


async def _latencies(plant: Plant, requests: int, seed: int) -> dict[str, Took]:
    """Time each request, one after the other, through the application without a socket."""
    app = app_of(plant, store=open_store(plant.service), rig=FakeRig(), analyst=FakeAnalyst())
    found: dict[str, Took] = {}
    async with app.router.lifespan_context(app):
        settle_memory()
        transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60.0) as client:
            first = (await client.get("/tests", params={"limit": 200})).json()
            for name, path in _lists(list(plant.valves), [test["id"] for test in first["tests"]], seed).items():
                took = found[name] = Took()
                ends_s = time.monotonic() + _LIST_S
                for index in range(requests + 2):
                    if index > _FEWEST and time.monotonic() > ends_s:
                        break
                    began_s, processor_s = time.perf_counter(), time.process_time()
                    answer = await client.get(path())
                    taken_s = time.perf_counter() - began_s, time.process_time() - processor_s
                    assert answer.status_code == 200, (name, answer.text[:300])
                    if index >= 2:  # the first ones compile and fill caches
                        took.wall_s.append(taken_s[0])
                        took.processor_s.append(taken_s[1])
                _say(f"{name}: {' '.join(took.shown())} ms of {len(took.wall_s)}")
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
    table = Table(
        *(
            "store",
            "tests",
            "request",
            "median, ms",
            "p99, ms",
            "processor, median, ms",
            "processor, p99, ms",
            "limit, ms",
        ),
        title="lists of a large plant",
    )
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
            for request, took in asyncio.run(_latencies(plant, REQUESTS, seed=5)).items():
                table.add_row(name, f"{VALVES * count:,}", request, *took.shown(), f"{1e3 * _LIMIT_S:.0f}")
    return table
