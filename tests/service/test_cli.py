from __future__ import annotations

import asyncio
import json
import re
import resource
import signal
import statistics
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from drivers.addresses import ValveWiring
from drivers.permissive import Permissive
from service.cli import COMMANDS
from service.config.settings import load_plant
from tests.service.command_line import called
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from valve.errors import DeviceError
from valve.messages import say

BREAKAWAY = (sys.executable, "-m", "service.cli")


def started(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What a process of its own says."""
    return subprocess.run([*BREAKAWAY, *arguments], capture_output=True, text=True, timeout=300, check=False)


def test_help_names_every_command_and_loads_none_of_them() -> None:
    code = "import sys; sys.argv = ['breakaway', '--help']\nfrom service.cli import main\ntry:\n    main()\n"
    code += "except SystemExit as end:\n    assert end.code == 0\n"
    code += "print(sorted(set(sys.modules) & {'numpy', 'numba', 'fastapi', 'httpx', 'sqlalchemy', 'pymodbus'}))\n"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    for command in COMMANDS:
        assert command in answer.stdout
    assert answer.stdout.splitlines()[-1] == "[]"


def test_the_version_is_told() -> None:
    answer = started("--version")
    assert (answer.returncode, answer.stdout) == (0, f"breakaway {version('breakaway')}\n")


def test_help_comes_at_once() -> None:
    used_s = []
    for _ in range(3):
        before_s = _processor_time_of_children_s()
        started("--help")
        used_s.append(_processor_time_of_children_s() - before_s)
    assert statistics.median(used_s) < 2.0, "0.3 s on an idle machine"


def _processor_time_of_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_each_help_names_no_type_of_the_programming_language(command: str) -> None:
    answer = called(*filter(None, [command]), "--help")
    assert answer.returncode == 0
    assert "Usage: " in answer.stdout
    assert not re.search(r"<\w+>|list\[|None", answer.stdout), answer.stdout


@pytest.mark.parametrize("arguments", [("fly",), ("serve",), ("run",), ("run", "FV-101", "--speed", "3")])
def test_wrong_usage_ends_with_2(arguments: tuple[str, ...]) -> None:
    answer = called(*arguments)
    assert answer.returncode == 2
    assert "Traceback" not in answer.stderr


def test_a_bad_plant_file_ends_with_1_and_one_sentence(plant_file: Path, plant_text: str) -> None:
    plant_file.write_text(plant_text.replace("port = 5020", "prt = 5020"), encoding="utf-8")
    answer = started("serve", "--config", str(plant_file))
    assert answer.returncode == 1
    assert answer.stderr.splitlines() == [
        "breakaway: plant.toml: buses[0].prt = 5020: this key is unknown: write port",
    ]


def test_a_service_that_is_not_there_ends_with_1_and_one_sentence() -> None:
    answer = called("run", "FV-101", "--url", "http://127.0.0.1:1")
    assert answer.returncode == 1
    assert len(answer.stderr.splitlines()) == 1
    assert "breakaway serve" in answer.stderr


@pytest.mark.parametrize("url", ["nonsense", "ftp://127.0.0.1", "http://", "http://[::1"])
def test_an_address_that_is_none_is_told_before_anything_is_asked(url: str) -> None:
    answer = called("run", "FV-101", "--url", url)
    assert answer.returncode == 1
    assert "is no address" in answer.stderr
    assert len(answer.stderr.splitlines()) == 1


@pytest.mark.parametrize("command", ["serve", "simulate"])
@pytest.mark.parametrize("file", [".", "missing.toml", "/dev/null"])
def test_a_plant_file_that_cannot_be_read_is_the_same_sentence_everywhere(
    command: str, file: str, tmp_path: Path
) -> None:
    answer = called(command, "--config", file, folder=tmp_path)
    assert answer.returncode == 1
    assert answer.stderr.startswith("breakaway: ")
    assert "Traceback" not in answer.stderr


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


async def test_run_names_the_permit_and_what_the_test_stands_for(plant_file: Path) -> None:
    rig = FakeRig(0.2)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        named = ("--permit", "W-17", "--label", "as_left", "--json", "--url", str(client.base_url))
        process = await asyncio.create_subprocess_exec(*BREAKAWAY, "run", "FV-101", *named, stdout=-1, stderr=-1)
        out, err = await asyncio.wait_for(process.communicate(), 60.0)
        assert process.returncode == 0, err.decode()
        assert json.loads(out)["label"] == "as_left"
        assert rig.permits == ["W-17"]


async def test_run_hands_overrides_on(plant_file: Path) -> None:
    async with running_service(load_plant(plant_file), FakeRig(0.2), FakeAnalyst()) as client:
        given = ("--sequence", "triangle", "--override", "cycles=1", "--override", "period_s=8.0")
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", *given, "--json", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        out, err = await asyncio.wait_for(process.communicate(), 60.0)
        assert process.returncode == 0, err.decode()
        assert json.loads(out)["overrides"] == {"cycles": 1, "period_s": 8.0}


async def test_why_a_test_failed_is_told_in_units_that_people_read(plant_file: Path) -> None:
    rig = FakeRig()
    rig.break_at, rig.failure = (
        0.5,
        DeviceError(
            say(
                "moved",
                "{tag}: it moved by {by:.4g Pa} and stood at {at:.4g m}",
                tag="FV-101",
                by=8.141e4,
                at=0.0485455,
            )
        ),
    )
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        _, err = await asyncio.wait_for(process.communicate(), 60.0)
        assert process.returncode == 1
        assert "it moved by 81.41 kPa and stood at 48.55 mm" in err.decode()


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
        assert err.decode().startswith("breakaway: FV-101: the test failed: ")
        assert err.decode().count("FV-101: ") == 1


class SlowToAnswer(FakeRig):
    """Reads its permissives until ``answer`` is set: the request to start waits for its answer."""

    def __init__(self) -> None:
        super().__init__(30.0)
        self.asked, self.answer = asyncio.Event(), asyncio.Event()

    async def permissives(self, wiring: ValveWiring, permit: str | None) -> tuple[Permissive, ...]:
        self.asked.set()
        await self.answer.wait()
        return await super().permissives(wiring, permit)


async def test_ctrl_c_before_the_answer_stops_the_test_that_the_answer_names(plant_file: Path) -> None:
    rig = SlowToAnswer()
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        await asyncio.wait_for(rig.asked.wait(), 30.0)
        process.send_signal(signal.SIGINT)
        rig.answer.set()
        _, err = await asyncio.wait_for(process.communicate(), 30.0)
        assert process.returncode == 1
        assert "stopped on request" in err.decode()
        assert (await client.get("/tests")).json()["tests"][0]["state"] == "stopped"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_ctrl_c_and_a_closed_terminal_stop_the_test(plant_file: Path, number: signal.Signals) -> None:
    rig = FakeRig(30.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        process = await asyncio.create_subprocess_exec(
            *BREAKAWAY, "run", "FV-101", "--url", str(client.base_url), stdout=-1, stderr=-1
        )
        await asyncio.wait_for(rig.moving.wait(), 30.0)
        process.send_signal(number)
        _, err = await asyncio.wait_for(process.communicate(), 30.0)
        assert process.returncode == 1
        assert "stopped on request" in err.decode()
        assert (await client.get("/tests")).json()["tests"][0]["state"] == "stopped"
