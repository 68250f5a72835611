"""The service on real wires: the simulated plant's own record is the judge."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import pty
import signal
import sys
import termios
from pathlib import Path

import numpy as np
import pytest

from service.config.settings import load_plant
from simulator.assembly import SimulatedPlant
from simulator.record import Happening
from tests.support.fake_rig import FakeAnalyst
from tests.support.processes import Condition, hear_all_signals, moving, serving, until
from tests.support.running_service import running_service
from tests.support.stopwatch import Stopwatch
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, wired_plant
from valve.recording import Acquisition
from valve.recording_files import read_recording

SMALL = {"low_pa": 30_000.0, "high_pa": 40_000.0}
SHORT = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 1.0, **SMALL}}
SOME_SECONDS = {"valve": TAG, "overrides": {"cycles": 3, "period_s": 4.0, **SMALL}}
LONG = {"valve": TAG, "overrides": {"cycles": 10, "period_s": 20.0, **SMALL}}


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


def _at_the_terminal() -> None:
    hear_all_signals()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def _moves(plant: SimulatedPlant) -> Condition:
    async def moving_now() -> bool:
        return asked_pa(plant) > 29_000.0

    return moving_now


def _recorded(folder: Path) -> Condition:
    async def recorded() -> bool:
        return sum(entry.stat().st_size for entry in (folder / "plant-data" / "journals").iterdir()) > 5_000

    return recorded


def _no_watchdog_acted(plant: SimulatedPlant) -> bool:
    return not [event for event in plant.records[TAG].events if event.happening is Happening.WATCHDOG_TRIPPED]


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        # they take the same way in: `make long` has them
        pytest.param(signal.SIGHUP, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, marks=pytest.mark.long),
        pytest.param(signal.SIGQUIT, marks=pytest.mark.long),
    ],
)
async def test_a_signal_that_ends_the_motion_process_stops_the_test_and_leaves_the_valve_safe(
    quick_path: Path, number: signal.Signals
) -> None:
    async with wired_plant(quick_path) as (path, plant), moving(path) as motion, serving(path) as (_, client):
        location = (await client.post("/tests/run", json=LONG)).headers["location"]
        await until(_moves(plant), 60.0, "the motion")
        watching = asyncio.create_task(client.get(f"{location}/events"))
        await asyncio.sleep(0.1)
        motion.send_signal(number)
        code = await asyncio.wait_for(motion.wait(), 20.0)
        events = (await watching).text
        assert code == 0, path.with_name("plant.motion.log").read_text()
        assert '"state": "stopped"' in events
        assert "the motion process was shut down" in (await client.get(location)).json()["error"]
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        assert _no_watchdog_acted(plant)
        shown = await client.get(f"/valves/{TAG}/permissives")
        refused = await client.post("/tests/run", json=SHORT)
        assert (shown.status_code, refused.status_code) in {(200, 409), (503, 503)}, "nobody can look at its stem now"


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGKILL])
async def test_a_test_outlives_the_service_and_completes_when_that_is_back(
    quick_path: Path, number: signal.Signals
) -> None:
    async with wired_plant(quick_path) as (path, plant), moving(path):
        async with serving(path) as (process, client):
            location = (await client.post("/tests/run", json=SOME_SECONDS)).headers["location"]
            await until(_moves(plant), 60.0, "the motion")
            process.send_signal(number)
            await process.wait()
        assert asked_pa(plant) > 29_000.0
        async with serving(path) as (_, client):

            async def completed() -> bool:
                return (await client.get(location)).json()["state"] not in {"running", "analyzing"}

            await until(completed, 120.0, "the end of the test")
            body = (await client.get(location)).json()
            assert (body["state"], body["safe_confirmed"]) == ("completed", True), body["error"]
        recording = read_recording(quick_path / "plant-data" / "recordings" / f"{body['id']}.parquet")
        assert recording.duration_s == pytest.approx(12.0, abs=0.2)
        # a service takes longer to be back
        assert np.diff(recording.time_s).max() < 1.2, "it was sampled while no service lived"
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        assert _no_watchdog_acted(plant)
        assert list((quick_path / "plant-data" / "journals").iterdir()) == []


async def test_a_motion_process_that_is_killed_leaves_the_valve_to_its_watchdog_and_the_test_interrupted(
    quick_path: Path,
) -> None:
    async with (
        wired_plant(quick_path, watchdog_s=2.0) as (path, plant),
        moving(path) as motion,
        serving(path) as (_, client),
    ):
        location = (await client.post("/tests/run", json=LONG)).headers["location"]
        await until(_recorded(quick_path), 60.0, "a journal with samples")
        motion.kill()
        await motion.wait()

        async def interrupted() -> bool:
            return bool((await client.get(location)).json()["state"] == "interrupted")

        await until(interrupted, 30.0, "the end of the test")
        async with moving(path):

            async def safe() -> bool:
                return (await client.get(location)).json()["safe_confirmed"] is True

            await until(safe, 90.0, "the confirmation of the safe value")
            body = (await client.get(location)).json()
            assert "the motion process ended" in body["error"]
            assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
            assert len((await client.get(body["recording"]["href"])).text.splitlines()) > 2
            refused = await client.post("/tests/run", json=SHORT)
            assert refused.status_code == 423
            assert "acknowledge first" in refused.json()["detail"]


async def test_the_motion_process_alone_stops_a_valve(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, plant), moving(path), serving(path) as (service, client):
        location = (await client.post("/tests/run", json=LONG)).headers["location"]
        await until(_moves(plant), 60.0, "the motion")
        service.send_signal(signal.SIGSTOP)  # it hangs
        try:
            stopping = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "service.cli", "stop", TAG, "--config", str(path)), stdout=-1
            )
            said, _ = await asyncio.wait_for(stopping.communicate(), 60.0)
            assert (stopping.returncode, TAG in said.decode()) == (0, True)

            async def safe() -> bool:
                return asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)

            await until(safe, 5.0, "the safe value")
        finally:
            service.send_signal(signal.SIGCONT)

        async def stopped() -> bool:
            return bool((await client.get(location)).json()["state"] == "stopped")

        await until(stopped, 30.0, "the end of the test")


async def test_a_terminal_that_is_closed_leaves_the_valve_safe(quick_path: Path) -> None:
    """The whole group gets SIGHUP, and nothing can be written to the terminal any more."""
    async with wired_plant(quick_path) as (path, plant):
        master, slave = pty.openpty()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "service.cli", "motion", "--config", str(path)),
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
            return b"motion process listening" in said

        try:
            await until(listening, 180.0, "the start of the motion process")
            async with serving(path) as (_, client):
                (await client.post("/tests/run", json=LONG)).raise_for_status()
                await until(_moves(plant), 60.0, "the motion")
                os.close(master)
                await asyncio.wait_for(process.wait(), 20.0)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        assert process.returncode in (0, 120)  # 120: the interpreter could not flush its last words
        assert asked_pa(plant) == pytest.approx(SAFE_PA, abs=10.0)
        assert _no_watchdog_acted(plant)


async def test_what_whoever_started_the_motion_process_had_ignored_stays_ignored(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _):
        ignoring = "import signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
        run = "from service.cli import main; sys.argv[1:] = ['motion', '--config', sys.argv[1]]; main()"
        async with moving(path, "-c", ignoring + run, str(path)) as motion:
            motion.send_signal(signal.SIGHUP)  # as nohup wants it
            await asyncio.sleep(0.5)
            assert motion.returncode is None


@pytest.mark.long  # the fault bench kills both, too
async def test_after_kill_9_of_both_the_test_is_interrupted_its_samples_are_kept_and_the_valve_is_safe(
    quick_path: Path,
) -> None:
    async with wired_plant(quick_path, watchdog_s=20.0) as (path, plant):
        async with moving(path) as motion, serving(path) as (process, client):
            location = (await client.post("/tests/run", json=LONG)).headers["location"]
            await until(_recorded(quick_path), 60.0, "a journal with samples")
            for one in (process, motion):
                one.kill()
                await one.wait()
        assert asked_pa(plant) > 29_000.0
        async with moving(path), serving(path) as (_, client):

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
    async with wired_plant(quick_path) as (path, _), serving(path):
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
