"""``breakaway stop``: by a tag or a test's id, and what it says and returns where it could not stop anything."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from drivers.outcome import PlayOutcome
from service.config.settings import load_plant
from service.runs.execution import UPLOADING
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service

TAG = "FV-101"


async def stopped(what: str, url: str) -> tuple[int | None, str, str]:
    """Exit code, output and error output of the command."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "service.cli", "stop", what, "--url", url),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    out, err = await asyncio.wait_for(process.communicate(), 60.0)
    return process.returncode, out.decode(), err.decode()


@pytest.mark.parametrize("by", ["tag", "test"])
async def test_the_command_stops_a_running_test_and_says_that_the_valve_is_safe(plant_file: Path, by: str) -> None:
    rig = FakeRig(60.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        test = (await client.post("/tests/run", json={"valve": TAG})).json()
        await asyncio.wait_for(rig.moving.wait(), 20.0)
        code, out, err = await stopped(TAG if by == "tag" else test["id"], str(client.base_url))
        assert (code, err) == (0, "")
        assert out.startswith(f"{TAG}: test {test['id']} is stopped. Signal 0 kPa, read back. Stem ")
        assert out.endswith("Stem 0 mm: 0 % open, not judged.\n")
        assert (await client.get(f"/tests/{test['id']}")).json()["state"] == "stopped"
        code, _, err = await stopped(TAG, str(client.base_url))
        assert code == 1
        assert TAG in err
        assert "Traceback" not in err


class Uploading(FakeRig):
    """A device whose own samples are fetched after its valve is at its safe value; ``fetched`` ends that."""

    def __init__(self) -> None:
        super().__init__(60.0)
        self.fetched = asyncio.Event()

    async def play(self, *said: Any) -> PlayOutcome:
        outcome = await super().play(*said)
        said[2].on_progress(1.0, UPLOADING)
        await self.fetched.wait()
        return outcome


async def test_a_valve_that_is_safe_while_its_samples_are_fetched_is_no_failed_stop(plant_file: Path) -> None:
    rig = Uploading()
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        test = (await client.post("/tests/run", json={"valve": TAG})).json()
        await asyncio.wait_for(rig.moving.wait(), 20.0)
        code, out, err = await stopped(TAG, str(client.base_url))
        assert (await client.get(f"/tests/{test['id']}")).json()["state"] == "running"
        rig.fetched.set()
        assert (code, err) == (0, "")
        said = "stopped, its samples are being fetched. Signal 0 kPa, read back. Stem may still move: it is looked at "
        assert said in out


async def test_a_stop_that_left_the_valve_unconfirmed_is_an_error(plant_file: Path) -> None:
    rig = FakeRig(60.0)
    rig.safe_confirmed = False
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        await client.post("/tests/run", json={"valve": TAG})
        await asyncio.wait_for(rig.moving.wait(), 20.0)
        code, out, err = await stopped(TAG, str(client.base_url))
        assert (code, out) == (1, "")
        assert "SAFE STATE NOT CONFIRMED" in err


async def test_a_service_that_does_not_answer_is_said_and_what_makes_the_valve_safe_then() -> None:
    code, _, err = await stopped(TAG, "http://127.0.0.1:9")
    assert code == 1
    assert "no answer" in err
    assert "watchdog" in err
