"""A night of many valves for real: gateways on one PostgreSQL, simulated valves on Modbus TCP, one gateway killed.

Each gateway is a process with the whole application on the durable engine; only the analysis is a light one, which
reads the recording back. The valves' clock runs faster than the service's, so that a test takes little more than its
transactions. In the middle of the night one gateway is killed and started again. The judge is each gateway's audit log,
which says when a valve was armed, beside the rows.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
import structlog
from rich.table import Table
from sqlalchemy import Engine, text

from service.analysis.analysis import analyze_recordings
from service.cli.demo_plant import free_ports
from service.config.settings import load_plant
from service.http.given import part_of
from service.model.check import Check, CheckState
from service.schedules.nightly import Nightly
from service.store.database import open_database
from service.store.run_table import RunTable
from service.store.schedule_run_table import ScheduleRunTable
from service.workers.warm_up import warm_up
from tests.bench.benchmarks.processor import used_by_role_s
from tests.support.databases import postgresql_database, why_no_server
from tests.support.fake_rig import FakeAnalyst
from tests.support.in_process import app_of
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.rough_valves import case as rough_case

VALVES: Final = 1000
GATEWAYS: Final = 4
_VALVES_A_BUS: Final = 25  # 5,000 valves on 200 buses
_SPEED: Final = 20.0
_KILLED: Final = 1  # which of the gateways
_KILLED_AT: Final = 0.4  # of its checks, once so many have ended
_LONGEST_S: Final = 3600.0
_LOOK_S: Final = 0.5
_POLLED_S: Final = 0.01
_PATIENCE_S: Final = 20.0  # all gateways and valves share this machine: a process may wait for its turn
_TOLD_S: Final = 30.0
_ENDS: Final = (datetime(1970, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC))


@dataclass(frozen=True)
class _Plant:
    """The plant files of the gateways, and that of the simulated valves."""

    gateways: Sequence[Path]
    valves: Path
    buses: int


def _tag(number: int) -> str:
    return f"FV-{number:04d}"


def _write(folder: Path, url: str, valves: int) -> _Plant:
    buses = -(-valves // _VALVES_A_BUS)
    ports = free_ports(buses)
    named = "".join(f'[[gateways]]\nname = "g{one}"\nurl = "http://127.0.0.1:{one + 1}"\n' for one in range(GATEWAYS))
    plant = "".join(
        bus_text(f"b{bus}", ports[bus], f'gateway = "g{bus % GATEWAYS}"\ntimeout_s = {_PATIENCE_S}')
        for bus in range(buses)
    )
    for number in range(valves):
        simulation = f'[valves.simulation]\nparameter_set = "nominal"\nposition_noise_m = 5.0e-6\nseed = {number}\n'
        plant += valve_text(
            _tag(number),
            f"b{number // _VALVES_A_BUS}",
            number % _VALVES_A_BUS + 1,
            rate_pa_per_s=60000.0,
            period_s=0.01,
            watchdog_s=_PATIENCE_S,
            more=simulation,
        )
    plant += f"""
[[schedules]]
name = "nightly"
cron = "30 2 1 1 *"
zone = "UTC"
valves = {json.dumps([_tag(number) for number in range(valves)])}
sequence = "triangle"
overrides = {{ cycles = 2, period_s = 10.0 }}
window_s = {_LONGEST_S}
"""
    files = []
    for one in range(GATEWAYS):
        (folder / f"g{one}").mkdir()
        files.append(folder / f"g{one}" / "plant.toml")
        service = service_text(f'database = "{url}"\ngateway = "g{one}"', store=folder / f"g{one}" / "data")
        files[-1].write_text(service + named + plant, encoding="utf-8")
    return _Plant(files, files[0], buses)


@dataclass(frozen=True)
class _Started:
    """A process, and the file into which it says what it says: a pipe that nobody reads would stop it."""

    process: subprocess.Popen[bytes]
    said: Path

    def wait(self, lines: int) -> None:
        """Return when it has said so many lines."""
        while self.said.read_bytes().count(b"\n") < lines:
            assert self.process.poll() is None, f"it ended before it was ready: {self.process.args!r}"
            time.sleep(_LOOK_S)


def _started(stack: contextlib.ExitStack, said: Path, *command: str) -> _Started:
    """Start a Python module as a process that is killed with the stack."""
    with said.open("wb") as out, said.with_suffix(".err").open("wb") as err:
        process = subprocess.Popen((sys.executable, "-m", *command), stdout=out, stderr=err)
    stack.callback(process.wait)
    stack.callback(process.kill)
    return _Started(process, said)


def _gateway(stack: contextlib.ExitStack, file: Path, *more: str) -> _Started:
    said = file.parent / f"said-{'-'.join(more) or 'again'}"
    return _started(stack, said, "tests.bench.benchmarks.night", str(file), *more)


def _armed(plant: _Plant) -> Counter[str]:
    """How often each valve was armed for a motion, by the audit logs."""
    found: Counter[str] = Counter()
    for file in plant.gateways:
        for log in (file.parent / "data" / "audit").iterdir():
            for line in log.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                found[entry["valve"]] += entry["event"] == "motion.armed"
    return found


def _checks(engine: Engine) -> list[Check]:
    return ScheduleRunTable(engine).between(*_ENDS)


def _say(words: str) -> None:
    sys.stderr.write(f"{words}\n")
    sys.stderr.flush()


def _night(stack: contextlib.ExitStack, plant: _Plant, engine: Engine, valves: int) -> dict[str, float]:
    """Let the night pass, with one gateway killed in the middle; return when what happened, s from its begin."""
    simulated = ("service.cli", "simulate", "--config", str(plant.valves), "--speed", f"{_SPEED:g}")
    valves_process = _started(stack, plant.valves.parent / "valves", *simulated)
    valves_process.wait(plant.buses)
    running = [_gateway(stack, file, "run") for file in plant.gateways]
    for one in running:
        one.wait(1)
    began_s, told_s, killed_s, back_s, before_s = time.monotonic(), 0.0, None, 0.0, 0.0
    mine = f"g{_KILLED}"
    while True:
        checks = _checks(engine)
        now_s = time.monotonic() - began_s
        ended = sum(check.state.ended for check in checks)
        if now_s - told_s > _TOLD_S:
            told_s = now_s
            _say(f"{now_s:.0f} s: {ended} of {len(checks)} checks have ended")
        own = [check.state.ended for check in checks if check.gateway == mine]
        if killed_s is None and own and sum(own) >= _KILLED_AT * len(own):
            killed = running[_KILLED].process
            before_s = used_by_role_s(killed.pid, killed.pid, valves_process.process.pid)["service"]
            killed.send_signal(signal.SIGKILL)
            killed.wait()
            killed_s = now_s
            _say(f"{now_s:.0f} s: {mine} is killed")
            running[_KILLED] = _gateway(stack, plant.gateways[_KILLED])
            running[_KILLED].wait(1)
            _say(f"{time.monotonic() - began_s:.0f} s: {mine} serves again")
            back_s = time.monotonic() - began_s
        if len(checks) == valves and ended == valves:
            assert killed_s is not None
            used = [used_by_role_s(one.process.pid, one.process.pid, valves_process.process.pid) for one in running]
            own_s = [role["service"] for role in used]
            return {
                "ended": now_s,
                "killed": killed_s,
                "back": back_s,
                "gateways": sum(own_s) + before_s,
                "busiest": max(own_s),
                "valves": used[0]["devices"],
            }
        assert now_s < _LONGEST_S, f"{ended} of {len(checks)} checks have ended"
        time.sleep(_LOOK_S)


def _sizes(engine: Engine, plant: _Plant, tests: int) -> list[tuple[str, str]]:
    """What a test leaves: in each table with its indexes, and as a recording."""
    with engine.begin() as connection:
        relations = connection.execute(
            text(
                "SELECT relname, pg_total_relation_size(relid) FROM pg_catalog.pg_statio_user_tables "
                "WHERE schemaname IN ('public', 'dbos') ORDER BY 2 DESC LIMIT 6"
            )
        ).all()
        rows = connection.execute(
            text("SELECT xact_commit FROM pg_stat_database WHERE datname = current_database()")
        ).scalar_one()
    files = [path.stat().st_size for one in plant.gateways for path in (one.parent / "data" / "recordings").iterdir()]
    found = [(f"database, {name}, bytes a test", f"{size / tests:,.0f}") for name, size in relations]
    found.append(("recording, bytes a test", f"{np.mean(files):,.0f}"))
    found.append(("database commits a test, DBOS' polling and this program's looks included", f"{rows / tests:,.0f}"))
    return found


def run(valves: int | None = None) -> list[Table]:
    """Return what one test takes, and what became of a night of many; a number is that of valves."""
    return [_test(), _of_night(valves)]


def _of_night(valves: int | None) -> Table:
    count = VALVES if valves is None else valves
    table = Table("what", "measured", title=f"a night of {count:,} valves, {GATEWAYS} gateways, one of them killed")
    if why_no_server():
        table.add_row("not run: it needs PostgreSQL", why_no_server())
        return table
    with tempfile.TemporaryDirectory() as folder, postgresql_database() as url, contextlib.ExitStack() as stack:
        plant = _write(Path(folder), url, count)
        engine = open_database(url)
        stack.callback(engine.dispose)
        at_s = _night(stack, plant, engine, count)
        checks = _checks(engine)
        states = Counter(check.state for check in checks)
        tests = [run for run in RunTable(engine).newest(2 * count) if run.schedule]
        twice = [tag for tag, many in Counter(run.valve for run in tests).items() if many > 1]
        armed = _armed(plant)
        armed_twice = [tag for tag, many in armed.items() if many > 1]
        moved_s = [
            (run.motion_ended_at - run.started_at).total_seconds()
            for run in tests
            if run.motion_ended_at is not None and run.started_at is not None
        ]
        lost = count - sum(many for state, many in states.items() if state.ended)
        rows: list[tuple[str, str]] = [
            ("buses, valves on each", f"{plant.buses}, {_VALVES_A_BUS}"),
            ("night, from its begin to the last check, s", f"{at_s['ended']:.0f}"),
            ("one gateway killed at, serving again at, s", f"{at_s['killed']:.0f}, {at_s['back']:.0f}"),
            ("checks by state", ", ".join(f"{many} {state.value}" for state, many in sorted(states.items()))),
            ("valves with two tests; armed twice (audit logs)", f"{len(twice)}; {len(armed_twice)}"),
            ("checks lost", str(lost)),
            ("tests a minute", f"{60 * len(tests) / at_s['ended']:.0f}"),
            ("of a test: start to rest, median, s", f"{np.median(moved_s):.1f}"),
            ("processor time a test, gateway, s", f"{at_s['gateways'] / len(tests):.2f}"),
            ("processor time a test, simulated valves, s", f"{at_s['valves'] / len(tests):.2f}"),
            ("the busiest gateway's share of a core", f"{at_s['busiest'] / at_s['ended']:.0%}"),
            *_sizes(engine, plant, len(tests)),
        ]
        rows += [
            (check.valve, check.reason) for check in checks if check.state in (CheckState.FAILED, CheckState.SKIPPED)
        ]
        for row in rows:
            table.add_row(*row)
    return table


def _test() -> Table:
    """Return what the analysis of a real test takes on one core, and the size of its document."""
    table = Table(
        *("valve", "recording", "rows", "analysis, processor s", "its document, bytes", "compressed (zlib 1), bytes"),
        title="the analysis of one multi-rate test (58 s) of a valve with a usual packing",
    )
    warm_up()
    for valve in ("nominal", "large"):
        for period_s in (0.001, 0.02):
            one = rough_case(valve, "multi_rate", "usual", period_s, seed=1)
            began_s = time.process_time()
            document = json.dumps(analyze_recordings([one.recording], one.nameplate)).encode()
            took_s = time.process_time() - began_s
            how = "captured, 1 kHz" if period_s < _POLLED_S else "polled, 50 Hz"
            sizes = (f"{len(document):,}", f"{len(zlib.compress(document, 1)):,}")
            table.add_row(valve, how, f"{one.recording.samples:,}", f"{took_s:.1f}", *sizes)
    return table


async def _serve(file: Path, *, begin: bool) -> None:
    """Be one gateway, until it is killed; ``begin`` lets its night begin at once."""
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    app = app_of(load_plant(file), analyst=FakeAnalyst())
    async with app.router.lifespan_context(app):
        if begin:
            await part_of(app, Nightly).run_now("nightly", "bench")
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        await asyncio.Event().wait()


if __name__ == "__main__":
    import uvloop

    uvloop.run(_serve(Path(sys.argv[1]), begin=sys.argv[2:] == ["run"]))
