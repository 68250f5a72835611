"""A service's nights as a process of their own: python -m tests.service.night_process PLANT SECONDS [run]."""

from __future__ import annotations

import asyncio
import signal
import sys
from pathlib import Path

from service.config.settings import load_plant
from service.runs.reanalyses import Reanalyses
from service.schedules.lifespan import running_schedules
from service.schedules.nightly import Nightly
from service.store.store import open_store
from tests.service.stored_runs import runs_of
from tests.support.fake_rig import FakeRig


async def main(plant_file: Path, duration_s: float, run: bool) -> None:
    ended = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    plant = load_plant(plant_file)
    store = open_store(plant.service)
    runs = runs_of(plant, store, FakeRig(duration_s))
    await runs.recover()
    nightly = Nightly(plant, store, runs)
    reanalyses = Reanalyses(plant, store, runs, software="breakaway 0")
    async with running_schedules(nightly, reanalyses, plant, store, runs):
        if run:
            await nightly.run_now("nightly", "test")
        print("ready", flush=True)
        await ended.wait()
    store.close()
    print("ended", flush=True)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), float(sys.argv[2]), sys.argv[3:] == ["run"]))
