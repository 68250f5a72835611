"""mbpoll (libmodbus) as an independent judge of frames and numbers."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from simulator.assembly import SimulatedPlant, reference_unit
from simulator.clock import ManualClock
from simulator.listeners import Listener, RtuListener, TcpListener
from tests.support.simulated_plants import valve

pytestmark = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")


async def mbpoll(*arguments: str) -> dict[int, str]:
    """Run one poll or write; values by the reference that mbpoll prints (counted from 1)."""
    process = await asyncio.create_subprocess_exec(
        "mbpoll", "-q", "-1", "-B", *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    async with asyncio.timeout(60.0):
        output, _ = await process.communicate()
    text = output.decode()
    assert process.returncode == 0, text
    return {int(found[1]): found[2] for found in re.finditer(r"^\[(\d+)\]:\s+(\S+)", text, re.MULTILINE)}


@pytest.fixture(params=["tcp", "rtu"])
async def wire(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[tuple[SimulatedPlant, list[str]]]:
    link = tmp_path / "line"
    listener: Listener = TcpListener() if request.param == "tcp" else RtuListener(link)
    plant = SimulatedPlant([valve("A")], {listener: [reference_unit(3, "A")]}, ManualClock())
    await plant.start()
    if request.param == "tcp":
        host, port = plant.addresses[0].rsplit(":", 1)
        yield plant, ["-m", "tcp", "-a", "3", "-p", port, host]
    else:
        yield plant, ["-m", "rtu", "-b", "115200", "-P", "even", "-a", "3", str(link)]
    await plant.stop()


async def test_mbpoll_reads_identity_and_floats_and_moves_the_valve(wire: tuple[SimulatedPlant, list[str]]) -> None:
    plant, address = wire
    identity = await mbpoll("-t", "4:hex", "-r", "1", "-c", "2", *address)
    assert identity == {1: "0x4257", 2: "0x4159"}
    # run number 5 takes the device
    await mbpoll("-t", "4", "-r", "37", *address, "0", "5", "1")
    # run number 5 and 50000 Pa (0x47435000) in one write
    await mbpoll("-t", "4", "-r", "33", *address, "0", "5", str(0x4743), str(0x5000))
    assert isinstance(plant.clock, ManualClock)
    plant.clock.advance(10.0)
    live = await mbpoll("-t", "4:float", "-r", "19", "-c", "4", *address)
    stem = plant.valves["A"].stem
    assert stem.position_m > 0.02
    assert float(live[19]) == pytest.approx(stem.position_m, abs=3e-6)
    assert float(live[23]) == pytest.approx(50000.0, abs=1.0)
