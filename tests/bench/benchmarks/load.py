"""16 valves at once on 16 buses at 50 Hz, 50 tablets looking, 100 requests a second, all as processes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import httpx
import numpy as np
from rich.table import Table

from service.cli.demo_plant import free_ports
from service.cli.demo_processes import DemoProcess, demo_processes, wait_until_ready
from tests.bench.benchmarks.processor import machine_used_s, used_by_role_s
from tests.bench.benchmarks.scheduling import CALLERS, DEVICES, as_elsewhere, refuse_precedence
from tests.bench.benchmarks.slots import lateness_s, missed_in_answers
from valve.recording import Recording
from valve.recording_files import recording_from_bytes

VALVES: Final = 16
TABLETS: Final = 50
REQUESTS_PER_S: Final = 100
MOTION_S: Final = 20
PERIOD_S: Final = 0.02
LATENESS_S: Final = 0.020  # p99
ANSWER_S: Final = 0.250  # p99
ROLES: Final = ("motion", "service", "analyses", "devices", "callers")
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
    """What the tablets and the other callers met, and who used the processor meanwhile."""

    answers_s: list[float] = field(default_factory=list)
    device_s: list[float] = field(default_factory=list)  # answers of a device that no test uses
    failed: int = 0
    events: int = 0
    used_s: Mapping[str, float] = field(default_factory=dict)  # processor time by role
    lasted_s: float = 0.0
    beyond: float = math.nan  # share of the samples that began later than asked


def run(seconds: int | None, *, ordinary: bool = False) -> list[Table]:
    """Return lateness, missed slots and answers, quiet and under load; a number is that of seconds of motion.

    The service has real-time precedence where the system allows it, as deployed, unless it is to be ``ordinary``.
    """
    motion_s = MOTION_S if seconds is None else seconds
    if ordinary:
        refuse_precedence()
    table = Table(
        title=f"{VALVES} valves at once on {VALVES} buses at {1.0 / PERIOD_S:.0f} Hz",
        caption=f"asked: lateness p99 < {1e3 * LATENESS_S:.0f} ms, no slot missed because of the load, answers p99 < "
        f"{1e3 * ANSWER_S:.0f} ms; {TABLETS} live views, {REQUESTS_PER_S} requests/s by the clock; "
        "under load the quiet tests are still being analysed; in answers: missed behind a sample that mostly waited "
        "for its device's answers, behind the others the service was late",
    )
    beyond = f"over {1e3 * LATENESS_S:.0f} ms, %"
    lateness, answers = ("late p50, ms", "p99, ms", "p99.9, ms", beyond), ("p50, ms", "p99, ms", "failed")
    for name in ("", "samples", *lateness, "missed", "in answers", "ms a sample", "events", "answers", *answers):
        table.add_column(name, justify="left" if not name else "right")
    shares = Table(
        title="Processor time by role, cores",
        caption=f"of {os.cpu_count()} cores, by the system's own account; other: everything else on this machine",
    )
    for name in ("", *ROLES, "other", "idle"):
        shares.add_column(name, justify="left" if not name else "right")
    devices = Table(title="Answers of a device that no test uses, as the callers see them")
    for name in ("", "answers", "p50, ms", "p99, ms", "p99.9, ms", "longest, ms"):
        devices.add_column(name, justify="left" if not name else "right")
    with tempfile.TemporaryDirectory() as folder:
        ports = free_ports(2 + VALVES)
        config = Path(folder) / "plant.toml"
        text = f'[service]\nstore = "store"\nport = {ports[0]}\n'
        text += "".join(
            _VALVE.format(number=number, port=port, period_s=PERIOD_S) for number, port in enumerate(ports[1:], 1)
        )
        config.write_text(text, encoding="utf-8")
        with demo_processes(config) as processes:
            asyncio.run(wait_until_ready(f"http://127.0.0.1:{ports[0]}", processes, VALVES + 1))
            as_elsewhere(processes[0].process.pid, DEVICES)
            kind = "precedence" if asyncio.run(_has_precedence(ports[0])) else "ordinary"
            for name, loaded in ((f"quiet, {kind}", False), (f"under load, {kind}", True)):
                recordings, looked = asyncio.run(_phase(ports, motion_s, loaded, processes))
                table.add_row(name, *_row(recordings, looked))
                devices.add_row(name, *_device_row(looked))
                shares.add_row(name, *_shares(looked))
    return [table, devices, shares]


def _row(recordings: Sequence[Recording], looked: _Looked) -> list[str]:
    late_s = np.concatenate([lateness_s(one, PERIOD_S) for one in recordings])
    missed = sum(one.sampling_quality().missed_slots for one in recordings)
    in_answers = sum(missed_in_answers(one, PERIOD_S) for one in recordings)
    late = (f"{1e3 * np.quantile(late_s, share):.1f}" for share in (0.5, 0.99, 0.999))
    row = [
        f"{late_s.size:,}",
        *late,
        f"{100.0 * looked.beyond:.2f}",
        str(missed),
        str(in_answers),
        f"{1e3 * looked.used_s['motion'] / late_s.size:.2f}",
    ]
    if not looked.answers_s:
        return [*row, "", "0", "", "", ""]
    answers = (f"{1e3 * np.quantile(looked.answers_s, share):.0f}" for share in (0.5, 0.99))
    return [*row, f"{looked.events:,}", f"{len(looked.answers_s):,}", *answers, str(looked.failed)]


def _device_row(looked: _Looked) -> list[str]:
    shares = (0.5, 0.99, 0.999, 1.0)
    return [f"{len(looked.device_s):,}", *(f"{1e3 * np.quantile(looked.device_s, share):.1f}" for share in shares)]


def _shares(looked: _Looked) -> list[str]:
    cores = [looked.used_s[role] / looked.lasted_s for role in (*ROLES, "other")]
    return [f"{share:.2f}" for share in (*cores, (os.cpu_count() or 1) - sum(cores))]


async def _has_precedence(port: int) -> bool:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=30.0) as client:
        return "\nbreakaway_polling_precedence 1.0" in (await client.get("/metrics")).text


async def _counted(client: httpx.AsyncClient) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return how many samples the service has taken, and how many of them in time, by its own exact account."""
    counted = np.zeros(2)
    for line in (await client.get("/metrics")).text.splitlines():
        name, _, value = line.rpartition(" ")
        if name.startswith("breakaway_sampling_lateness_seconds_count"):
            counted[0] += float(value)
        elif name.startswith("breakaway_sampling_lateness_seconds_bucket") and f'le="{LATENESS_S}"' in name:
            counted[1] += float(value)
    return counted


async def _phase(
    ports: Sequence[int], motion_s: int, loaded: bool, processes: Sequence[DemoProcess]
) -> tuple[list[Recording], _Looked]:
    looked, port = _Looked(), ports[0]
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=30.0) as client:
        before = await _counted(client)
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
        async with _accounted(processes, looked), _called(ports, tests, looked, loaded=loaded):
            for test in tests:  # one after the other: who measures must cost little
                await asyncio.wait_for(_moved(client, test), _MOVED_S + motion_s)
        for test in tests:  # the next ones begin when their stems have been looked at
            await asyncio.wait_for(_looked_at(client, test), _MOVED_S)
        parquet = {"Accept": "application/vnd.apache.parquet"}
        taken, in_time = await _counted(client) - before
        looked.beyond = 1.0 - in_time / taken
        files = [await client.get(f"{test}/recording", headers=parquet) for test in tests]
    return [recording_from_bytes(file.content, "a test's recording") for file in files], looked


@contextlib.asynccontextmanager
async def _accounted(processes: Sequence[DemoProcess], looked: _Looked) -> AsyncIterator[None]:
    """Account for the processor while the context lasts; what the callers used, they say themselves."""
    devices, motion, service = (one.process.pid for one in processes)
    began_s, before, machine_s = time.monotonic(), used_by_role_s(service, motion, devices), machine_used_s()
    yield
    looked.lasted_s = time.monotonic() - began_s
    after = used_by_role_s(service, motion, devices)
    used_s = {role: after[role] - before[role] for role in before} | {"callers": looked.used_s.get("callers", 0.0)}
    looked.used_s = used_s | {"other": max(0.0, machine_used_s() - machine_s - sum(used_s.values()))}


@contextlib.asynccontextmanager
async def _called(ports: Sequence[int], tests: Sequence[str], looked: _Looked, *, loaded: bool) -> AsyncIterator[None]:
    """Let tablets look and others ask, from a process of their own, until the context ends; one device always is."""
    callers = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "tests.bench.benchmarks.callers",
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        limit=2**24,
    )
    assert callers.stdin is not None
    assert callers.stdout is not None
    asked = {"tablets": TABLETS, "requests_per_s": REQUESTS_PER_S} if loaded else {"tablets": 0, "requests_per_s": 0}
    wanted = {"port": ports[0], "device": ports[-1], "tests": tests, **asked}
    as_elsewhere(callers.pid, CALLERS)
    callers.stdin.write(json.dumps(wanted).encode() + b"\n")
    try:
        yield
    finally:
        callers.stdin.close()
        said = json.loads(await callers.stdout.readline())
        await callers.wait()
    looked.answers_s, looked.failed, looked.events = said["answers_s"], said["failed"], said["events"]
    looked.device_s = said["device_s"]
    looked.used_s = {"callers": said["used_s"]}


async def _moved(client: httpx.AsyncClient, test: str) -> None:
    while True:
        state = (await client.get(test)).json()
        assert state["state"] in {"queued", "running", "analyzing", "completed"}, state["error"]
        if state["motion_ended_at"] is not None:
            return
        await asyncio.sleep(1.0)


async def _looked_at(client: httpx.AsyncClient, test: str) -> None:
    while True:
        stands = (await client.get(test)).json()["stands"]
        if stands is not None and stands["verdict"] != "moving":
            return
        await asyncio.sleep(1.0)
