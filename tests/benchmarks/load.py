"""16 valves at once on 16 buses at 50 Hz, 50 tablets looking, 100 requests a second, all as processes."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import os
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import httpx
import numpy as np
from rich.table import Table

from service.cli.demo_plant import free_ports
from service.cli.demo_processes import DemoProcess, demo_processes, wait_until_ready
from valve.recording import Recording
from valve.recording_files import recording_from_bytes

VALVES: Final = 16
TABLETS: Final = 50
REQUESTS_PER_S: Final = 100
MOTION_S: Final = 20
PERIOD_S: Final = 0.02
LATENESS_S: Final = 0.020  # p99
ANSWER_S: Final = 0.250  # p99
_MOVED_S: Final = 120.0

_VALVE: Final = """
[[buses]]
name = "bus-{number}"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {port}
timeout_s = 2.0
[[valves]]
tag = "FV-{number}"
safe_value_pa = 0.0
actuator = {{ diaphragm_area_m2 = 0.06452, travel_m = 0.1016 }}
signal = {{ range_ma = [4.0, 20.0], range_pa = [0.0, 82737.0] }}
limits = {{ pressure_pa = [0.0, 82737.0], pressure_rate_pa_per_s = 60000.0, longest_test_s = 300.0 }}
command = {{ bus = "bus-{number}", device_id = 1, map = "reference" }}
acquisition = {{ mode = "polled", period_s = {period_s} }}
watchdog = {{ timeout_s = 5.0 }}
simulation = {{ parameter_set = "nominal", position_noise_m = 5.0e-6, seed = {number} }}
"""


@dataclass
class _Looked:
    """What the tablets and the other callers met."""

    answers_s: list[float] = field(default_factory=list)
    refused: int = 0
    events: int = 0
    bytes: int = 0
    used_s: float = 0.0  # processor time that the service used
    lasted_s: float = 0.0


def run(seconds: int | None) -> Table:
    """Return lateness, missed slots and answers, quiet and under load; a number is that of seconds of motion."""
    motion_s = MOTION_S if seconds is None else seconds
    table = Table(
        title=f"{VALVES} valves at once on {VALVES} buses at {1.0 / PERIOD_S:.0f} Hz",
        caption=f"asked: lateness p99 < {1e3 * LATENESS_S:.0f} ms, no slot missed because of the load, answers p99 < "
        f"{1e3 * ANSWER_S:.0f} ms; {TABLETS} live views, {REQUESTS_PER_S} requests/s by the clock. Devices, service "
        f"and callers share {os.cpu_count()} cores (columns: what of them the service used), where "
        f"{os.getloadavg()[0]:.0f} processes were busy before; under load the quiet tests are still being analysed",
    )
    lateness, answers = ("late p50, ms", "p99, ms", "p99.9, ms"), ("p50, ms", "p99, ms", "failed")
    for name in ("", "samples", *lateness, "missed", "cores", "ms a sample", "answers", *answers):
        table.add_column(name, justify="left" if not name else "right")
    with tempfile.TemporaryDirectory() as folder:
        ports = free_ports(1 + VALVES)
        config = Path(folder) / "plant.toml"
        text = f'[service]\nstore = "store"\nport = {ports[0]}\n'
        text += "".join(
            _VALVE.format(number=number, port=port, period_s=PERIOD_S) for number, port in enumerate(ports[1:], 1)
        )
        config.write_text(text, encoding="utf-8")
        with demo_processes(config) as processes:
            asyncio.run(wait_until_ready(f"http://127.0.0.1:{ports[0]}", processes, VALVES))
            for name, loaded in (("quiet", False), ("under load", True)):
                recordings, looked = asyncio.run(_phase(ports[0], motion_s, loaded, processes))
                table.add_row(name, *_row(recordings, looked))
    return table


def _row(recordings: Sequence[Recording], looked: _Looked) -> list[str]:
    late_s = np.concatenate([lateness_s(one, PERIOD_S) for one in recordings])
    missed = sum(one.sampling_quality().missed_slots for one in recordings)
    late = (f"{1e3 * np.quantile(late_s, share):.1f}" for share in (0.5, 0.99, 0.999))
    cores, each_ms = looked.used_s / looked.lasted_s, 1e3 * looked.used_s / late_s.size
    row = [f"{late_s.size:,}", *late, str(missed), f"{cores:.2f}", f"{each_ms:.2f}"]
    if not looked.answers_s:
        return [*row, "0", "", "", ""]
    answers = (f"{1e3 * np.quantile(looked.answers_s, share):.0f}" for share in (0.5, 0.99))
    return [*row, f"{len(looked.answers_s):,}", *answers, str(looked.refused)]


def lateness_s(recording: Recording, period_s: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return how long after its slot each sample's first transaction began, s; its slot is as polled play chooses."""
    sent_s, written_s, received_s = recording.sent_s, recording.write_sent_s, recording.received_s
    assert sent_s is not None
    assert written_s is not None
    assert received_s is not None
    late, slot = np.empty(sent_s.size), 0
    for index, ended_s in enumerate(received_s.tolist()):
        late[index] = np.fmin(written_s[index], sent_s[index]) - slot * period_s
        slot = max(slot + 1, math.floor(ended_s / period_s + 0.5))
    return late


async def _phase(
    port: int, motion_s: int, loaded: bool, processes: Sequence[DemoProcess]
) -> tuple[list[Recording], _Looked]:
    looked = _Looked()
    limits = httpx.Limits(max_connections=None, max_keepalive_connections=None)
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=30.0, limits=limits) as client:
        overrides = {"cycles": 1, "period_s": float(motion_s)}
        asked = await asyncio.gather(
            *(
                client.post("/tests/run", json={"valve": f"FV-{one}", "sequence": "triangle", "overrides": overrides})
                for one in range(1, VALVES + 1)
            )
        )
        for answer in asked:
            assert answer.status_code == 202, answer.text
        tests = [answer.json()["href"] for answer in asked]
        began_s, used_s = time.monotonic(), _used_s(processes[-1])
        async with _watched(client, tests, looked) if loaded else contextlib.nullcontext():
            await asyncio.wait_for(asyncio.gather(*(_moved(client, test) for test in tests)), _MOVED_S + motion_s)
        looked.used_s, looked.lasted_s = _used_s(processes[-1]) - used_s, time.monotonic() - began_s
        parquet = {"Accept": "application/vnd.apache.parquet"}
        files = [await client.get(f"{test}/recording", headers=parquet) for test in tests]
    return [recording_from_bytes(file.content, "a test's recording") for file in files], looked


def _used_s(process: DemoProcess) -> float:
    """Return the processor time that a process has used, s (proc(5): utime and stime)."""
    fields = Path(f"/proc/{process.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _moved(client: httpx.AsyncClient, test: str) -> None:
    while True:
        state = (await client.get(test)).json()
        assert state["state"] in {"queued", "running", "analyzing", "completed"}, state["error"]
        if state["motion_ended_at"] is not None:
            return
        await asyncio.sleep(1.0)


@contextlib.asynccontextmanager
async def _watched(client: httpx.AsyncClient, tests: Sequence[str], looked: _Looked) -> AsyncIterator[None]:
    """Let tablets look and others ask, until the context ends."""
    tasks = [asyncio.create_task(_look(client, tests[one % len(tests)], looked)) for one in range(TABLETS)]
    tasks.append(asyncio.create_task(_ask(client, tests, looked)))
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _look(client: httpx.AsyncClient, test: str, looked: _Looked) -> None:
    async with client.stream("GET", f"{test}/events") as stream:
        async for line in stream.aiter_lines():
            looked.events += line.startswith("data:")
            looked.bytes += len(line) + 1


async def _ask(client: httpx.AsyncClient, tests: Sequence[str], looked: _Looked) -> None:
    """Ask by the clock, whether the one before was answered or not; an answer's time counts from when it was due."""
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    paths = itertools.cycle(["/valves", "/valves/FV-3", "/tests", tests[0], "/healthz", "/", tests[-1], "/valves/FV-9"])
    async with asyncio.TaskGroup() as group:
        for number in itertools.count():
            due_s = began_s + number / REQUESTS_PER_S
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            group.create_task(_asked(client, next(paths), due_s, looked))


async def _asked(client: httpx.AsyncClient, path: str, due_s: float, looked: _Looked) -> None:
    try:
        answer = await client.get(path)
        looked.refused += not answer.is_success
    except httpx.HTTPError:
        looked.refused += 1
    finally:  # one that is still waiting when the motion ends took at least so long
        looked.answers_s.append(asyncio.get_running_loop().time() - due_s)
