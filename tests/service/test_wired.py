"""The service on real wires: the simulated plant's own record is the judge."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import sys
import termios
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.cli.signals import ENDING_SIGNALS
from service.config.settings import load_plant
from simulator.record import Happening
from tests.support.fake_rig import FakeAnalyst
from tests.support.running_service import running_service
from tests.support.stopwatch import Stopwatch
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, wired_plant
from valve.recording import Acquisition
from valve.recording_files import read_recording

SMALL = {"low_pa": 30_000.0, "high_pa": 40_000.0}
SHORT = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 1.0, **SMALL}}
LONG = {"valve": TAG, "overrides": {"cycles": 10, "period_s": 20.0, **SMALL}}


async def until(condition: Any, within_s: float, what: str) -> None:
    deadline_s = time.monotonic() + within_s
    while not await condition():
        assert time.monotonic() < deadline_s, f"{what} did not happen within {within_s} s"
        await asyncio.sleep(0.02)


async def test_a_polled_test_runs_end_to_end(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, plant):
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            body = (await client.post("/tests/run", json=SHORT, headers={"Prefer": "wait=30"})).json()
        assert body["state"] == "completed", body["error"]
        assert body["safe_confirmed"] is True
        assert body["quality"]["achieved_rate_hz"] > 20.0
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        recording = read_recording(quick_path / "plant-data" / "recordings" / f"{body['id']}.parquet")
        assert recording.provenance.acquisition is Acquisition.POLLED
        assert recording.duration_s == pytest.approx(1.0, abs=0.1)
        assert list((quick_path / "plant-data" / "journals").iterdir()) == []


async def test_a_captured_test_runs_end_to_end(quick_path: Path) -> None:
    async with wired_plant(quick_path, mode="captured", period_s=0.001, speed=10.0) as (path, _):
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            order = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 6.0}}
            body = (await client.post("/tests/run", json=order, headers={"Prefer": "wait=60"})).json()
            events = (await client.get(f"{body['href']}/events")).text
        assert body["state"] == "completed", body["error"]
        assert body["quality"]["samples"] == 6001
        assert "event: samples" in events


async def test_stop_on_real_wires_reaches_the_valve_within_a_second(quick_path: Path) -> None:
    async with (
        wired_plant(quick_path) as (path, plant),
        running_service(load_plant(path), None, FakeAnalyst()) as client,
    ):
        location = (await client.post("/tests/run", json=LONG)).headers["location"]

        async def moving() -> bool:
            return asked_pa(plant) > 29_000.0

        await until(moving, 60.0, "the motion")
        watch = Stopwatch()
        body = (await client.post(f"{location}/stop")).json()
        assert watch.own_s < 1.0
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        assert body["safe_confirmed"] is True


async def test_a_device_that_is_not_there_permits_no_test_and_frees_the_bus(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _):
        plant = load_plant(path)
    async with running_service(plant, None, FakeAnalyst()) as client:
        for _ in range(2):
            answer = await client.post("/tests/run", json=SHORT, headers={"Prefer": "wait=30"})
            assert answer.status_code == 423
            assert "nothing was moved" in answer.json()["detail"]
        assert (await client.get("/tests")).json()["tests"] == []


def _hear_all_signals() -> None:
    """Let a process hear what whoever started the tests ignores: under nohup, or behind an ampersand."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def _at_the_terminal() -> None:
    _hear_all_signals()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@asynccontextmanager
async def served(config: Path, *how: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, httpx.AsyncClient]]:
    """Run ``breakaway serve`` as a process, or ``how`` Python does that, and hand out a client of it."""
    log = config.with_suffix(".log")
    with log.open("ab") as errors:
        start = log.stat().st_size
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, *(how or ("-m", "service.cli", "serve", "--config", str(config)))),
            stderr=errors,
            preexec_fn=_hear_all_signals,
        )
    try:

        async def listening() -> bool:
            assert process.returncode is None, log.read_text()
            return "listening" in log.read_text()[start:]

        await until(listening, 180.0, "the start of the service")
        url = re.findall(r"http://127\.0\.0\.1:\d+", log.read_text()[start:])[-1]
        async with httpx.AsyncClient(base_url=url, timeout=30.0) as client:

            async def healthy() -> bool:
                try:
                    return (await client.get("/healthz")).is_success
                except httpx.TransportError:
                    return False

            await until(healthy, 120.0, "the first answer")
            yield process, client
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        signal.SIGHUP,
        # they take the same way in: `make long` has them
        pytest.param(signal.SIGINT, marks=pytest.mark.long),
        pytest.param(signal.SIGQUIT, marks=pytest.mark.long),
    ],
)
async def test_a_signal_that_ends_the_service_stops_the_test_and_leaves_the_valve_safe(
    quick_path: Path, number: signal.Signals
) -> None:
    async with wired_plant(quick_path) as (path, plant), served(path) as (process, client):
        location = (await client.post("/tests/run", json=LONG)).headers["location"]

        async def moving() -> bool:
            return asked_pa(plant) > 29_000.0

        await until(moving, 60.0, "the motion")
        watching = asyncio.create_task(client.get(f"{location}/events"))
        await asyncio.sleep(0.1)
        process.send_signal(number)
        code = await asyncio.wait_for(process.wait(), 20.0)
        events = (await watching).text
        assert code == 0, path.with_suffix(".log").read_text()
        assert '"state": "stopped"' in events
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        tripped = [event for event in plant.records[TAG].events if event.happening is Happening.WATCHDOG_TRIPPED]
        assert tripped == []
        lines = [line for line in path.with_suffix(".log").read_text().splitlines() if line.startswith("{")]
        assert {"listening", "test accepted", "test ended", "ended"} <= {json.loads(line)["event"] for line in lines}


async def test_a_terminal_that_is_closed_leaves_the_valve_safe(quick_path: Path) -> None:
    """The whole group gets SIGHUP, and nothing can be written to the terminal any more."""
    async with wired_plant(quick_path) as (path, plant):
        master, slave = pty.openpty()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "service.cli", "serve", "--config", str(path)),
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=_at_the_terminal,
        )
        os.close(slave)
        os.set_blocking(master, False)
        said = b""

        async def listening() -> bool:
            nonlocal said
            with contextlib.suppress(BlockingIOError):
                said += os.read(master, 65536)
            return b'"event": "listening"' in said

        async def moving() -> bool:
            await listening()  # somebody reads what the terminal shows
            return asked_pa(plant) > 29_000.0

        try:
            await until(listening, 180.0, "the start of the service")
            (url,) = re.findall(rb"http://127\.0\.0\.1:\d+", said)
            async with httpx.AsyncClient(base_url=url.decode(), timeout=30.0) as client:
                (await client.post("/tests/run", json=LONG)).raise_for_status()
            await until(moving, 60.0, "the motion")
            os.close(master)
            await asyncio.wait_for(process.wait(), 20.0)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        assert process.returncode in (0, 120)  # 120: the interpreter could not flush its last words
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        record = plant.records[TAG]
        assert not [event for event in record.events if event.happening is Happening.WATCHDOG_TRIPPED]


async def test_what_whoever_started_the_service_had_ignored_stays_ignored(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _):
        ignoring = "import signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
        run = "from service.cli import main; sys.argv[1:] = ['serve', '--config', sys.argv[1]]; main()"
        async with served(path, "-c", ignoring + run, str(path)) as (process, client):
            process.send_signal(signal.SIGHUP)  # as nohup wants it
            await asyncio.sleep(0.5)
            assert (await client.get("/healthz")).is_success


async def test_after_kill_9_the_test_is_interrupted_its_samples_are_kept_and_the_valve_is_safe(
    quick_path: Path,
) -> None:
    async with wired_plant(quick_path, watchdog_s=20.0) as (path, plant):
        async with served(path) as (process, client):
            location = (await client.post("/tests/run", json=LONG)).headers["location"]
            journals = quick_path / "plant-data" / "journals"

            async def recorded() -> bool:
                return sum(entry.stat().st_size for entry in journals.iterdir()) > 5_000

            await until(recorded, 60.0, "a journal with samples")
            process.kill()
            await process.wait()
        assert asked_pa(plant) > 29_000.0
        async with served(path) as (_, client):

            async def safe() -> bool:
                return (await client.get(location)).json()["safe_confirmed"] is True

            await until(safe, 60.0, "the confirmation of the safe value")
            body = (await client.get(location)).json()
            assert body["state"] == "interrupted"
            assert "sent to its safe value" in body["error"]
            assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
            assert len((await client.get(body["recording"]["href"])).text.splitlines()) > 20
            refused = await client.post("/tests/run", json=SHORT)
            assert refused.status_code == 423
            assert "acknowledge first" in refused.json()["detail"]
            assert (await client.get("/valves")).json()["valves"][0]["alarms"] != []
            await client.post(f"{location}/acknowledge", json={"note": "looked at it: all is well"})
            assert (await client.get("/valves")).json()["valves"][0]["alarms"] == []
            assert (await client.post("/tests/run", json=SHORT)).status_code == 202


async def test_a_second_service_on_the_store_is_refused_in_one_sentence(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _), served(path):
        second = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "service.cli",
            "serve",
            "--config",
            str(path),
            stderr=asyncio.subprocess.PIPE,
        )
        _, said = await asyncio.wait_for(second.communicate(), 60.0)
        assert second.returncode == 1
        sentence = said.decode().strip().splitlines()[-1]
        assert sentence.startswith("breakaway: ")
        assert "another service" in sentence
        assert "Traceback" not in said.decode()
