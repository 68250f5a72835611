"""A real service with a simulated valve on a real wire, in a thread of its own: a browser is driven from another."""

from __future__ import annotations

import asyncio
import io
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import httpx
import uvicorn
from fastapi import FastAPI

from service.config.settings import load_plant
from service.http.given import part_of
from simulator.assembly import SimulatedPlant
from tests.support.in_process import app_of
from tests.support.made_analysis import made_analysis
from tests.support.wired_plant import asked_pa, wired_plant

Value = TypeVar("Value")

# Steps fill the time that they have, so the one sequence that needs no overrides takes 9 s.
LIMITS = "longest_test_s = 9.0\nsteps_allowed = true"
_FRAMES = 4  # of a thread that are told where it waits
# Once a year: no schedule comes in between a test. In one service alone: a process has one engine of jobs.
NIGHTLY = """
[[schedules]]
name = "new year"
cron = "15 1 1 1 *"
zone = "Europe/Berlin"
valves = ["FV-101"]
sequence = "steps"
window_s = 3600.0
"""


class MadeAnalyst:
    """Answers at once with a made-up analysis: what the pages show of it is tested, not how it is found."""

    async def analyze(self, *_: Any, **__: Any) -> dict[str, Any]:
        """Return the analysis."""
        return made_analysis()


@dataclass
class Gateway:
    """The running service; ``call`` does something in its thread."""

    url: str
    app: FastAPI
    plant: SimulatedPlant
    loop: asyncio.AbstractEventLoop
    client: httpx.Client = field(init=False)

    def __post_init__(self) -> None:
        self.client = httpx.Client(base_url=self.url, timeout=20.0)

    def part(self, kind: type[Value]) -> Value:
        """Return a part of the service."""
        return part_of(self.app, kind)

    def call(self, work: Callable[[], Value]) -> Value:
        """Return what ``work`` returns in the service's own thread."""

        async def run() -> Value:
            return work()

        return asyncio.run_coroutine_threadsafe(run(), self.loop).result(10.0)

    def asked_pa(self) -> float:
        """Return what the simulated device asks of its I/P now, Pa."""
        return self.call(lambda: asked_pa(self.plant))


@contextmanager
def gateway(folder: Path, *, access: str = "open", needs_permit: bool = False, stem: str = "") -> Iterator[Gateway]:
    """Serve a plant with one valve, whose longest test takes 9 s, until the block ends.

    One that is open and needs no permit has the schedule, too. ``stem`` is where its stem should be at the safe value.
    """

    def edited(text: str) -> str:
        text = text.replace("longest_test_s = 300.0", LIMITS).replace(
            "port = 0\n", f'port = 0\naccess = "{access}"\n', 1
        )
        if stem:
            return text.replace("stem_read_after_s = 0.0", stem)
        if needs_permit:
            return text.replace("[valves.watchdog]", "[valves.permissives]\npermit = true\n[valves.watchdog]", 1)
        return text + NIGHTLY if access == "open" else text

    started: Future[Gateway] = Future()
    ended = threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(_serve(folder, edited, started, ended)), daemon=True)
    thread.start()
    running = started.result(60.0)
    try:
        yield running
    finally:
        running.client.close()
        ended.set()
        thread.join(30.0)
        assert not thread.is_alive(), f"the service did not end: {_what_goes_on(running.loop)}"


def _what_goes_on(loop: asyncio.AbstractEventLoop) -> str:
    """Where each task of this loop and each thread of this process waits."""
    said = io.StringIO()
    for task in asyncio.all_tasks(loop):
        task.print_stack(file=said)
    for number, frame in sys._current_frames().items():
        said.write(f"thread {number}:\n{''.join(traceback.format_stack(frame)[-_FRAMES:])}")
    return said.getvalue()


async def _serve(folder: Path, edited: Callable[[str], str], started: Future[Gateway], ended: threading.Event) -> None:
    try:
        async with wired_plant(folder, period_s=0.02) as (path, plant):
            path.write_text(edited(path.read_text(encoding="utf-8")), encoding="utf-8")
            app = app_of(load_plant(path), analyst=MadeAnalyst())
            config = uvicorn.Config(app, host="127.0.0.1", port=0, log_config=None, lifespan="on", ws="none")
            server = uvicorn.Server(config)
            serving = asyncio.create_task(server.serve())
            while not server.started:
                if serving.done():
                    await serving
                await asyncio.sleep(0.01)
            port = server.servers[0].sockets[0].getsockname()[1]
            started.set_result(Gateway(f"http://127.0.0.1:{port}", app, plant, asyncio.get_running_loop()))
            await asyncio.to_thread(ended.wait)
            server.should_exit = True
            await serving
    except BaseException as error:
        if started.done():
            raise
        started.set_exception(error)
