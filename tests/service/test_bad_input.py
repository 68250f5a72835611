"""Bad input from the command line and over REST: one sentence, an exit code or a status, and a valve that rests."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config.settings import load_plant
from simulator.assembly import SimulatedPlant
from tests.service.command_line import called
from tests.support.fake_rig import FakeAnalyst
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from tests.support.wired_plant import TAG, wired_plant

NAMEPLATE = 'tag = "FV-101"\n[actuator]\ndiaphragm_area_m2 = 0.06452\ntravel_m = 0.1016\n'
HEADER = "time_s,pressure_pa,position_m\n"


async def breakaway(folder: Path, *arguments: str) -> tuple[int, str]:
    """Exit code and standard error of one command, as a process of its own while the service here goes on."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "service.cli", *arguments, cwd=folder, stdout=-1, stderr=-1
    )
    _, said = await asyncio.wait_for(process.communicate(), 60.0)
    assert process.returncode is not None
    return process.returncode, said.decode()


def assert_sentence(said: str, *parts: str) -> None:
    """Fail unless this is one sentence of ours with all these parts."""
    assert said.startswith("breakaway: "), said
    assert len(said.splitlines()) == 1, said
    for part in parts:
        assert part in said


def assert_untouched(plant: SimulatedPlant) -> None:
    """Fail unless nothing was written to the device and the stem is where it was."""
    plant.look()
    record = plant.records[TAG]
    assert list(record.events) == []
    assert set(record.track.position_m.tolist()) == {record.track.position_m[0]}


# What is written instead of what in a good plant file, and what the sentence must name: key, value, limit, remedy.
PLANTS: dict[str, tuple[str, str, list[str]]] = {
    "an unknown key": (
        "device_id = 1",
        "device_id = 1\nspeed = 9600",
        ["command.speed = 9600", "unknown", "remove it"],
    ),
    "a misspelled key": ("timeout_s = 2.0\n[[valves]]", "timeout = 2.0\n[[valves]]", ["timeout", "or give timeout_s"]),
    "registers that overlap": ("", "", ["valves[1].command", "FV-102", "FV-101", "same register", "correct one"]),
    "a travel in mm": ("travel_m = 0.1016", "travel_m = 101.6", ["travel_m", "101.6 m", "looks like mm"]),
    "limits beyond the I/P": (
        "[valves.limits]\npressure_pa = [0.0, 82737.0]",
        "[valves.limits]\npressure_pa = [0.0, 99000.0]",
        ["limits.pressure_pa", "99000", "82737 Pa", "stay inside"],
    ),
}


@pytest.mark.parametrize(("old", "new", "parts"), PLANTS.values(), ids=list(PLANTS))
@pytest.mark.parametrize("command", ["serve", "simulate"])
async def test_a_bad_plant_file_ends_with_1_a_sentence_and_no_motion(
    quick_path: Path, command: str, old: str, new: str, parts: list[str]
) -> None:
    async with wired_plant(quick_path) as (path, plant):
        good = path.read_text(encoding="utf-8")
        if old:
            assert old in good
            bad = good.replace(old, new)
        else:  # the same valve once more, under another tag
            bad = good + good[good.index("[[valves]]") :].replace(TAG, "FV-102")
        path.write_text(bad, encoding="utf-8")
        answer = called(command, "--config", path.name, folder=quick_path)
        assert answer.returncode == 1
        assert_sentence(answer.stderr, "plant.toml", *parts)
        assert_untouched(plant)
    assert not (quick_path / "plant-data").exists(), "nothing was started"


WAVES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "above the limit": ({"overrides": {"high_pa": 90_000.0}}, ["90000 Pa", "82737 Pa", "smaller range"]),
    "below the limit": ({"overrides": {"low_pa": -1.0}}, ["-1 to", "82737 Pa", "smaller range"]),
    "too steep": ({"overrides": {"period_s": 1.0}}, ["165474 Pa/s", "60000 Pa/s", "longer period"]),
    "a step": ({"sequence": "steps"}, ["60000 Pa/s", "allow steps"]),
    "too long": ({"overrides": {"cycles": 100}}, ["2000 s", "300 s", "fewer cycles"]),
    "in bar": ({"overrides": {"high_pa": "0.8 bar"}}, ["high_pa is '0.8 bar'", "valid number", "correct"]),
    "unknown": ({"sequence": "waltz"}, ["'waltz'", "triangle", "or separating"]),
}


@asynccontextmanager
async def wired_service(folder: Path) -> AsyncIterator[tuple[httpx.AsyncClient, SimulatedPlant]]:
    """Serve the simulated plant in ``folder``."""
    async with wired_plant(folder) as (path, plant), running_service(load_plant(path), None, FakeAnalyst()) as client:
        yield client, plant


@pytest.mark.parametrize(("wanted", "parts"), WAVES.values(), ids=list(WAVES))
async def test_a_waveform_beyond_the_limits_is_refused_and_nothing_moves(
    quick_path: Path, wanted: dict[str, Any], parts: list[str]
) -> None:
    async with wired_service(quick_path) as (client, plant):
        answer = await client.post("/tests/run", json={"valve": TAG, **wanted}, headers={"Prefer": "wait=5"})
        assert_problem(answer, 422, *parts)
        assert (await client.get("/tests")).json()["tests"] == []
        assert_untouched(plant)


async def test_the_command_line_says_the_same_of_a_waveform_and_ends_with_1(quick_path: Path) -> None:
    async with wired_service(quick_path) as (client, plant):
        code, said = await breakaway(
            quick_path, "run", TAG, "--sequence", "steps", "--url", str(client.base_url).rstrip("/")
        )
        assert code == 1
        assert_sentence(said, TAG, "limits.pressure_rate_pa_per_s", "60000 Pa/s", "allow steps")
        code, said = await breakaway(quick_path, "run", TAG, "--high-pa", "90000")
        assert code == 2
        assert "--high-pa" in said
        assert_untouched(plant)


RECORDINGS: dict[str, tuple[str, str, list[str]]] = {
    "time runs backwards": (f"{HEADER}0,0,0\n0.2,1,0\n0.1,2,0\n", NAMEPLATE, ["0.1", "increase"]),
    "time stands still": (f"{HEADER}0,0,0\n0.1,1,0\n0.1,2,0\n", NAMEPLATE, ["0.1", "increase"]),
    "an empty file": ("", NAMEPLATE, ["empty"]),
    "a header alone": (HEADER, NAMEPLATE, ["no row", "a sample"]),
    "a position in mm": (
        f"{HEADER}0,0,0\n0.1,1,50\n0.2,2,101\n",
        NAMEPLATE,
        ["101", "0.1016 m", "millimetres", "metres"],
    ),
    "a column in another unit": ("time_s,Pressure [V],position_m\n0,0,0\n", NAMEPLATE, ["Pressure [V]", "pressure_pa"]),
    "a travel in mm": (f"{HEADER}0,0,0\n0.1,1,0\n", NAMEPLATE.replace("0.1016", "101.6"), ["travel_m", "101.6", "mm"]),
    "an unknown key of the nameplate": (f"{HEADER}0,0,0\n", NAMEPLATE.replace("travel_m", "stroke_m"), ["stroke_m"]),
}


@pytest.mark.parametrize(("recording", "nameplate", "parts"), RECORDINGS.values(), ids=list(RECORDINGS))
async def test_a_bad_recording_or_nameplate_is_the_same_sentence_on_both_ways(
    quick_path: Path, plant_file: Path, recording: str, nameplate: str, parts: list[str]
) -> None:
    (quick_path / "bad.csv").write_text(recording, encoding="utf-8")
    (quick_path / "plate.toml").write_text(nameplate, encoding="utf-8")
    answer = called("analyze", "bad.csv", "--nameplate", "plate.toml", folder=quick_path)
    assert answer.returncode == 1
    assert_sentence(answer.stderr, *parts)
    async with running_service(load_plant(plant_file), None, FakeAnalyst()) as client:
        files = {"recording": ("bad.csv", recording), "nameplate": ("plate.toml", nameplate)}
        assert_problem(await client.post("/recordings/analyze", files=files), 422, *parts)
