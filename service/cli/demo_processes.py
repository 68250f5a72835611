"""The demonstration's processes: started together, watched, and ended together however the demonstration ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx

from service.cli.signals import ENDING_SIGNALS
from valve.errors import InternalError
from valve.messages import say

_START_TIMEOUT_S: Final = 180.0  # a first start compiles the kernels: 6 s on an idle machine, more on a busy one
_END_S: Final = 15.0  # valves are brought to their safe values first


@dataclass(frozen=True, slots=True)
class DemoProcess:
    """A breakaway command that runs as a process of its own; what it says goes to ``log``.

    To ``truths`` goes what the plant says of each test, for programs.
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    truths: Path

    @property
    def said(self) -> list[str]:
        """What it has said so far, line by line."""
        return self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()

    def require_alive(self) -> None:
        """Raise InternalError with its last words where it has ended."""
        code = self.process.poll()
        if code is not None:
            last = (self.said or ["it said nothing"])[-1]
            raise InternalError(
                say(
                    "demo_process_ended",
                    "demo: breakaway {command} ended by itself with code {exit_code}: {last}",
                    command=self.name,
                    exit_code=code,
                    last=last,
                )
            )


@contextlib.contextmanager
def demo_processes(config: Path) -> Iterator[list[DemoProcess]]:
    """Run a simulated plant, what moves its valves, and the service; at the end nothing of them is left."""
    running: list[DemoProcess] = []
    try:
        for name in ("simulate", "motion", "serve"):
            log = config.parent / f"{name}.log"
            truths = log.with_suffix(".jsonl")
            command = [sys.executable, "-m", "service.cli", name, "--config", str(config)]
            command += ["--truths", str(truths)] if name == "simulate" else []
            with log.open("wb") as output:
                # a session of its own: Ctrl-C in the terminal reaches the demonstration alone, which ends them in order
                process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)
            running.append(DemoProcess(name, process, log, truths))
        yield running
    finally:
        _end([one.process for one in reversed(running)])


async def wait_until_ready(base_url: str, processes: Sequence[DemoProcess], listeners: int) -> None:
    """Return when the simulated plant listens at all its ``listeners`` addresses and the service answers.

    Raises InternalError where one of them has ended, or they are not ready in time.
    """
    deadline = time.monotonic() + _START_TIMEOUT_S
    simulated = processes[0]
    async with httpx.AsyncClient(base_url=base_url, timeout=10.0) as client:
        while time.monotonic() < deadline:
            for one in processes:
                one.require_alive()
            with contextlib.suppress(httpx.TransportError):
                if len(simulated.said) >= listeners and (await client.get("/healthz")).is_success:
                    return
            await asyncio.sleep(0.1)
    raise InternalError(
        say(
            "demo_not_ready",
            "demo: plant and service were not ready within {limit:g} s: end what else keeps this machine busy, and "
            "start it again",
            limit=_START_TIMEOUT_S,
        )
    )


def _end(processes: list[subprocess.Popen[bytes]]) -> None:
    """Ask for the end, wait for it and at last enforce it; no further signal cuts this short."""
    former = {number: signal.signal(number, signal.SIG_IGN) for number in ENDING_SIGNALS}
    try:
        for process in processes:  # the plant last: its valves are brought to their safe values
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
