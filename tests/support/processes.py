"""The motion process and the service as a plant runs them: each by its command, in a session of its own."""

from __future__ import annotations

import asyncio
import contextlib
import re
import signal
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import httpx

from service.cli.signals import ENDING_SIGNALS
from tests.support.running_service import NO_TLS

Condition = Callable[[], Awaitable[bool]]


async def until(condition: Condition, within_s: float, what: str) -> None:
    deadline_s = time.monotonic() + within_s
    while not await condition():
        assert time.monotonic() < deadline_s, f"{what} did not happen within {within_s} s"
        await asyncio.sleep(0.02)


def hear_all_signals() -> None:
    """Let a process hear what whoever started the tests ignores: under nohup, or behind an ampersand."""
    for number in ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)


@asynccontextmanager
async def started(
    config: Path, name: str, saying: str, *how: str
) -> AsyncIterator[tuple[asyncio.subprocess.Process, str]]:
    """Run a command of breakaway, or ``how`` Python does that; hand it out with its log once that has ``saying``."""
    log = config.with_name(f"{config.stem}.{name}.log")
    with log.open("ab") as errors:
        start = log.stat().st_size
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, *(how or ("-m", "service.cli", name, "--config", str(config)))),
            stderr=errors,
            preexec_fn=hear_all_signals,
            start_new_session=True,
        )
    try:

        async def says() -> bool:
            assert process.returncode is None, log.read_text()
            return saying in log.read_text()[start:]

        await until(says, 180.0, f"the start of {name}")
        yield process, log.read_text()[start:]
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


@asynccontextmanager
async def moving(config: Path, *how: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run ``breakaway motion``."""
    async with started(config, "motion", "motion process listening", *how) as (process, _):
        yield process


@asynccontextmanager
async def serving(config: Path, *how: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, httpx.AsyncClient]]:
    """Run ``breakaway serve`` and hand out a client of it."""
    async with started(config, "serve", '"event": "listening"', *how) as (process, said):
        url = re.findall(r"http://127\.0\.0\.1:\d+", said)[-1]
        async with httpx.AsyncClient(base_url=url, timeout=30.0, verify=NO_TLS) as client:

            async def healthy() -> bool:
                with contextlib.suppress(httpx.TransportError):
                    return (await client.get("/healthz")).is_success
                return False

            await until(healthy, 120.0, "the first answer")
            yield process, client
