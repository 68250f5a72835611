from __future__ import annotations

import asyncio
import json
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from service.cli import COMMANDS
from service.settings import load_plant
from tests.service.fake_rig import FakeAnalyst, FakeRig
from tests.service.running_service import running_service

BREAKAWAY = (sys.executable, "-m", "service.cli")


def called(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*BREAKAWAY, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_help_names_every_command_and_loads_none_of_them() -> None:
    code = "import sys; sys.argv = ['breakaway', '--help']\nfrom service.cli import main\ntry:\n    main()\n"
    code += "except SystemExit as end:\n    assert end.code == 0\n"
    code += "print(sorted(set(sys.modules) & {'numpy', 'numba', 'fastapi', 'httpx', 'sqlalchemy', 'pymodbus'}))\n"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    for command in COMMANDS:
        assert command in answer.stdout
    assert answer.stdout.splitlines()[-1] == "[]"


def test_help_comes_at_once() -> None:
    taken_s = []
    for _ in range(3):
        start_s = time.process_time(), time.monotonic()
        called("--help")
        taken_s.append(time.monotonic() - start_s[1])
    assert statistics.median(taken_s) < 5.0, "0.3 s on an idle machine"


@pytest.mark.parametrize("command", ["serve", "run"])
def test_each_command_has_a_help_of_its_own(command: str) -> None:
    answer = called(command, "--help")
    assert answer.returncode == 0
    assert "Usage: " in answer.stdout


@pytest.mark.parametrize("arguments", [("fly",), ("serve",), ("run",), ("run", "FV-101", "--speed", "3")])
def test_wrong_usage_ends_with_2(arguments: tuple[str, ...]) -> None:
    answer = called(*arguments)
    assert answer.returncode == 2
    assert "Traceback" not in answer.stderr


def test_a_bad_plant_file_ends_with_1_and_one_sentence(plant_file: Path, plant_text: str) -> None:
    plant_file.write_text(plant_text.replace("port = 5020", "prt = 5020"), encoding="utf-8")
    answer = called("serve", "--config", str(plant_file))
    assert answer.returncode == 1
    assert answer.stderr.splitlines() == [
        "breakaway: plant.toml: buses[0].prt = 5020: this key is unknown: write port",
    ]


def test_a_service_that_is_not_there_ends_with_1_and_one_sentence() -> None:
    answer = called("run", "FV-101", "--url", "http://127.0.0.1:1")
    assert answer.returncode == 1
    assert len(answer.stderr.splitlines()) == 1
    assert "breakaway serve" in answer.stderr


async def test_run_follows_a_test_to_its_end_and_prints_it(plant_file: Path) -> None:
    async with running_service(load_plant(plant_file), FakeRig(0.5), FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--json", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        out, err = await asyncio.wait_for(process.communicate(), 60.0)
        assert process.returncode == 0, err.decode()
        assert json.loads(out)["state"] == "completed"
        refused = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-999", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        out, err = await asyncio.wait_for(refused.communicate(), 60.0)
        assert refused.returncode == 1
        assert "FV-999" in err.decode()
        assert "Traceback" not in err.decode()


async def test_run_ends_with_1_when_the_test_fails(plant_file: Path) -> None:
    rig = FakeRig()
    rig.safe_confirmed = False
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        _, err = await asyncio.wait_for(process.communicate(), 60.0)
        assert process.returncode == 1
        assert "SAFE STATE NOT CONFIRMED" in err.decode()


async def test_ctrl_c_stops_the_test(plant_file: Path) -> None:
    rig = FakeRig(30.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        await asyncio.wait_for(rig.moving.wait(), 30.0)
        await asyncio.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, err = await asyncio.wait_for(process.communicate(), 30.0)
        assert process.returncode == 1
        assert "stopped on request" in err.decode()
        assert (await client.get("/tests")).json()["tests"][0]["state"] == "stopped"
