"""Valves read in service at 10 Hz by one motion process: slots missed, its share of a core, a polled test beside it.

The valves answer from a process of their own (``watched_devices``), ten on a bus. The test is a polled one at 50 Hz of
a simulated valve on a bus of its own: alone, and while all the others are watched. Slots are what the motion process
counts itself, as ``/metrics`` shows them. The number after the name is that of the valves; WATCH_S is how long each
part takes, s.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx
import numpy as np
from rich.table import Table

from service.cli.demo_plant import free_ports
from tests.bench.benchmarks.processor import used_by_role_s
from tests.bench.benchmarks.scheduling import DEVICES, as_elsewhere
from tests.bench.benchmarks.slots import lateness_s
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.processes import moving, serving, started, until
from valve.recording_files import recording_from_bytes

VALVES: Final = 200
ON_A_BUS: Final = 10
PERIOD_S: Final = 0.1
TEST_PERIOD_S: Final = 0.02
PART_S: Final = float(os.environ.get("WATCH_S", "30"))
_SETTLES_S: Final = 5.0
_WATCH: Final = f"[valves.watch]\nperiod_s = {PERIOD_S}\n"
_SIMULATED: Final = '[valves.simulation]\nparameter_set = "nominal"\nposition_noise_m = 5.0e-6\n'


@dataclass
class _Part:
    """What one part of the benchmark met."""

    slots: Counter[str]
    lasted_s: float
    used_s: float
    late_s: np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None = None
    missed: int = 0


def run(valves: int | None = None) -> Table:
    """Return slots, processor share and the test's lateness: the test alone, the valves alone, both."""
    count = VALVES if valves is None else valves
    alone, watched, both = asyncio.run(_measured(count))
    table = Table(
        title=f"{count} valves watched at {1.0 / PERIOD_S:.0f} Hz by one process, and a polled test at "
        f"{1.0 / TEST_PERIOD_S:.0f} Hz beside them, {PART_S:g} s each",
        caption="missed: slots that began a period late or more; cores: of the motion process",
    )
    slots, late = ("slots read", "missed", "failed", "cores", "ms a read"), ("late p50, ms", "p99, ms", "p99.9, ms")
    for heading in ("", *slots, "test samples", *late, "test missed"):
        table.add_column(heading, justify="right" if heading else "left")
    for name, part in (("test alone", alone), ("watched alone", watched), ("both", both)):
        table.add_row(name, *_slot_cells(part), *_test_cells(part))
    return table


def _slot_cells(part: _Part) -> list[str]:
    read = part.slots["read"]
    a_read = f"{1e3 * part.used_s / read:.2f}" if read and part.late_s is None else ""
    counted = [f"{part.slots[name]:,}" if read else "" for name in ("read", "missed", "failed")]
    return [*counted, f"{part.used_s / part.lasted_s:.2f}", a_read]


def _test_cells(part: _Part) -> list[str]:
    if part.late_s is None:
        return [""] * 5
    late = (f"{1e3 * np.quantile(part.late_s, share):.2f}" for share in (0.5, 0.99, 0.999))
    return [f"{part.late_s.size:,}", *late, str(part.missed)]


async def _measured(count: int) -> tuple[_Part, _Part, _Part]:
    buses = -(-count // ON_A_BUS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ports = free_ports(2 + buses)
        quiet, busy, tested = (folder / f"{one}.toml" for one in ("quiet", "busy", "tested"))
        test = bus_text("bus-t", ports[1], "timeout_s = 2.0") + valve_text(
            "FV-T", "bus-t", mode="polled", period_s=TEST_PERIOD_S, watchdog_s=5.0, more=_SIMULATED
        )
        tested.write_text(service_text(store="store-t") + test, encoding="utf-8")
        watched = "".join(bus_text(f"bus-{one}", port) for one, port in enumerate(ports[2:]))
        for number in range(count):
            bus, unit = f"bus-{number // ON_A_BUS}", number % ON_A_BUS + 1
            watched += valve_text(f"FV-{number}", bus, unit, more=_WATCH)
        quiet.write_text(service_text(store="store-q") + test, encoding="utf-8")
        busy.write_text(service_text(store="store-b") + test + watched, encoding="utf-8")
        devices = ("-m", "tests.bench.benchmarks.watched_devices", str(ON_A_BUS), *map(str, ports[2:]))
        async with AsyncExitStack() as stack:
            simulated, _ = await stack.enter_async_context(started(tested, "simulate", ""))
            others, _ = await stack.enter_async_context(started(tested, "devices", "serving", *devices))
            await until(lambda: _answers(ports[1]), 120.0, "the simulated valve's start")
            for process in (simulated, others):
                as_elsewhere(process.pid, DEVICES)
            async with _running(quiet) as (motion, service, client):
                alone = await _part(client, motion, service, tests=True)
            async with _running(busy) as (motion, service, client):
                await asyncio.sleep(_SETTLES_S)
                only = await _part(client, motion, service, tests=False)
                both = await _part(client, motion, service, tests=True)
    return alone, only, both


async def _answers(port: int) -> bool:
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
    except OSError:
        return False
    writer.close()
    return True


@asynccontextmanager
async def _running(config: Path) -> AsyncIterator[tuple[int, int, httpx.AsyncClient]]:
    async with moving(config) as motion, serving(config) as (service, client):
        yield motion.pid, service.pid, client


async def _part(client: httpx.AsyncClient, motion: int, service: int, *, tests: bool) -> _Part:
    before, began_s, used_s = await _slots(client), time.monotonic(), used_by_role_s(service, motion, motion)["motion"]
    late_s, missed = None, 0
    if tests:
        overrides = {"cycles": 1, "period_s": PART_S}
        asked = {"valve": "FV-T", "sequence": "triangle", "overrides": overrides}
        answer = await client.post("/tests/run", json=asked)
        assert answer.status_code == 202, answer.text
        test = answer.json()["href"]

        async def moved() -> bool:
            await asyncio.sleep(1.0)
            state = (await client.get(test)).json()
            assert state["state"] in {"queued", "running", "analyzing", "completed"}, state["error"]
            return state["motion_ended_at"] is not None

        await until(moved, PART_S + 120.0, "the end of the test's motion")
    else:
        await asyncio.sleep(PART_S)
    lasted_s = time.monotonic() - began_s
    used_s = used_by_role_s(service, motion, motion)["motion"] - used_s
    slots = await _slots(client)
    slots.subtract(before)
    if tests:
        file = await client.get(f"{test}/recording", headers={"Accept": "application/vnd.apache.parquet"})
        recording = recording_from_bytes(file.content, "a test's recording")
        late_s, missed = lateness_s(recording, TEST_PERIOD_S), recording.sampling_quality().missed_slots
    return _Part(slots, lasted_s, used_s, late_s, missed)


async def _slots(client: httpx.AsyncClient) -> Counter[str]:
    """Return what became of all slots so far, by the motion process' own count."""
    counted: Counter[str] = Counter()
    for line in (await client.get("/metrics")).text.splitlines():
        if line.startswith("breakaway_watch_slots_total{"):
            outcome = line.partition('outcome="')[2].partition('"')[0]
            counted[outcome] += round(float(line.rpartition(" ")[2]))
    return counted
