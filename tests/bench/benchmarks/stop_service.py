"""How long it takes from pressing Stop to the write of the safe value: through the whole service, whatever else fails.

The service is a process of its own, its valves are simulated here. Stop is pressed in mid-motion: alone, while 50
tablets watch, while PostgreSQL answers nobody, and while the disk is full.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import math
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import httpx
import numpy as np
from rich.table import Table

from service.cli.demo_plant import free_ports
from simulator.assembly import SimulatedPlant, SimulatedUnit, reference_unit
from simulator.listeners import Listener, TcpListener
from simulator.plant import warm_up
from simulator.record import Event, Happening
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from tests.bench.faults.surroundings import Surroundings, drop_template, why_not
from tests.bench.faults.wire_faults import PlantFault
from tests.support.plants import bus_text, service_text, valve_text
from valve.parameter_sets import PARAMETER_SETS

STOPS: Final = 1000
ASKED_S: Final = 0.05  # p99.9, beside the transaction under way
TABLETS: Final = 50
VALVES: Final = 4
_SAFE_PA: Final = 12_345.0
_READY_S: Final = 60.0
_PATIENCE_S: Final = 30.0
_ORDER: Final = {"cycles": 1, "period_s": 20.0, "low_pa": 15_000.0, "high_pa": 60_000.0}


class Beside(StrEnum):
    """What else goes on while Stop is pressed."""

    NOTHING = "nothing"
    TABLETS = "50 tablets watch"
    DARK_DATABASE = "PostgreSQL answers nobody"
    FULL_DISK = "the disk is full"


_FAULTS: Final = {Beside.DARK_DATABASE: PlantFault.DARK_DATABASE, Beside.FULL_DISK: PlantFault.FULL_DISK}


@dataclass
class _Bench:
    """One service with its valves."""

    client: httpx.AsyncClient
    around: Surroundings
    events: dict[str, list[tuple[float, Event]]]
    found_s: list[float] = field(default_factory=list)
    answers_s: list[float] = field(default_factory=list)


def run(count: int | None) -> Table:
    """Stop so many tests beside each of the disturbances and return the table."""
    stops = STOPS if count is None else count
    warm_up()
    table = Table(
        title=f"From pressing Stop in a client to the safe value on the wire, {stops} stops a row",
        caption=f"asked: p99.9 below {1e3 * ASKED_S:.0f} ms; {VALVES} valves move at once; service, devices and "
        "clients on the same cores; not safe: no safe value within 30 s",
    )
    for name in ("beside", "median, ms", "p99, ms", "p99.9, ms", "longest, ms", "answered, p99, ms", "not safe"):
        table.add_column(name, justify="left" if name == "beside" else "right")
    try:
        for beside in Beside:
            reason = why_not(_FAULTS.get(beside))
            if reason:
                table.add_row(beside.value, *[""] * 5, reason)
                continue
            with tempfile.TemporaryDirectory(prefix="breakaway-stop-") as folder:
                row = _row(*asyncio.run(_stopped(beside, stops, Path(folder))))
            print(f"{beside.value}: {' | '.join(row)}", flush=True)  # a thousand stops take minutes
            table.add_row(beside.value, *row)
    finally:
        drop_template()
    return table


def _row(found_s: Sequence[float], answers_s: Sequence[float]) -> list[str]:
    seen = np.array([one for one in found_s if math.isfinite(one)])
    shares = [_quantile_ms(seen, share) for share in (0.5, 0.99, 0.999, 1.0)]
    return [*shares, _quantile_ms(answers_s, 0.99), str(len(found_s) - seen.size)]


def _quantile_ms(times_s: Sequence[float] | np.ndarray[Any, np.dtype[np.float64]], share: float) -> str:
    return f"{1e3 * np.quantile(times_s, share):.1f}" if len(times_s) else ""


async def _stopped(beside: Beside, stops: int, folder: Path) -> tuple[list[float], list[float]]:
    async with _service(beside, folder) as bench:
        for turn in range(math.ceil(stops / VALVES)):
            await _one_turn(bench, beside, random.Random(turn))
        return bench.found_s, bench.answers_s


@asynccontextmanager
async def _service(beside: Beside, folder: Path) -> AsyncIterator[_Bench]:
    tags = [f"FV-{number}" for number in range(1, VALVES + 1)]
    chosen = PARAMETER_SETS["nominal"]
    valves = [
        SimulatedValve(
            tag,
            chosen.parameters,
            chosen.nameplate,
            Transducer((0.0, 82_737.0)),
            Sensor((-0.005, 0.107)),
            Sensor((-4000.0, 87_000.0)),
            start_pa=_SAFE_PA,
        )
        for tag in tags
    ]
    listeners: dict[Listener, list[SimulatedUnit]] = {
        TcpListener(f"127.0.0.{number}"): [reference_unit(1, tag)] for number, tag in enumerate(tags, 1)
    }
    plant = SimulatedPlant(valves, listeners)
    events: dict[str, list[tuple[float, Event]]] = {tag: [] for tag in tags}
    for tag in tags:
        plant.records[tag].sink = _keeper(events[tag])
    async with AsyncExitStack() as stack:
        await plant.start()
        stack.push_async_callback(plant.stop)
        around = Surroundings(_FAULTS.get(beside), tags[0])
        (folder / "store").mkdir()
        await around.set_up(stack, folder)
        port = free_ports(1)[0]
        text = service_text(f'database = "{around.database}"' if around.database else "", store="store", port=port)
        for number, tag in enumerate(tags):
            host, _, device_port = plant.addresses[number].rpartition(":")
            text += bus_text(f"bus-{tag}", device_port, "timeout_s = 2.0").replace("127.0.0.1", host)
            text += valve_text(
                tag,
                f"bus-{tag}",
                safe=str(_SAFE_PA),
                rate_pa_per_s=200_000.0,
                mode="captured" if number % 2 else "polled",
                period_s=0.002 if number % 2 else 0.02,
                watchdog_s=10.0,
            )
        config = folder / "plant.toml"
        config.write_text(text, encoding="utf-8")
        for name in ("motion", "serve"):
            await _running(stack, name, config, folder / f"{name}.log")
        client = await stack.enter_async_context(
            httpx.AsyncClient(
                base_url=f"http://127.0.0.1:{port}",
                timeout=_PATIENCE_S,
                # sooner than the service closes an idle connection; a connection for each tablet
                limits=httpx.Limits(max_connections=None, keepalive_expiry=2.0),
            )
        )
        await _until(lambda: _answers(client), _READY_S)
        gc.collect()
        gc.freeze()  # a full collection holds the simulated devices, and the stop-watch, for a tenth of a second
        yield _Bench(client, around, events)


def _keeper(events: list[tuple[float, Event]]) -> Callable[[Event | tuple[float, float, float, float]], None]:
    def keep(entry: Event | tuple[float, float, float, float]) -> None:
        if isinstance(entry, Event):
            events.append((time.monotonic(), entry))

    return keep


async def _running(stack: AsyncExitStack, name: str, config: Path, log: Path) -> None:
    """Start a command of breakaway; it is ended with the stack."""
    command = [sys.executable, "-m", "service.cli", name, "--config", str(config)]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)  # noqa: ASYNC220

    def end() -> None:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_PATIENCE_S)
        process.kill()
        process.wait()

    stack.push_async_callback(asyncio.to_thread, end)


async def _answers(client: httpx.AsyncClient) -> bool:
    with contextlib.suppress(httpx.TransportError):
        return (await client.get("/healthz")).is_success
    return False


async def _until(done: Callable[[], Awaitable[bool]], within_s: float) -> None:
    until_s = time.monotonic() + within_s
    while not await done():
        if time.monotonic() > until_s:
            raise TimeoutError(f"not within {within_s:g} s")
        await asyncio.sleep(0.05)


async def _one_turn(bench: _Bench, beside: Beside, chance: random.Random) -> None:
    """Let all valves move, disturb, press Stop on each at an instant of its own, and put everything right again."""
    tags = list(bench.events)
    tests = await asyncio.gather(*(_begun(bench, tag) for tag in tags))
    async with AsyncExitStack() as stack:
        if beside is Beside.TABLETS:
            for number in range(TABLETS):
                await stack.enter_async_context(_watching(bench.client, tests[number % len(tests)]))
        bench.around.strike()
        await asyncio.gather(
            *(_stop(bench, tag, test, chance.uniform(0.1, 0.6)) for tag, test in zip(tags, tests, strict=True))
        )
        await bench.around.mend()
        for tag, test in zip(tags, tests, strict=True):
            await _until(lambda test=test: _over(bench.client, test), _PATIENCE_S)  # type: ignore[misc]
            await bench.client.post(f"{test}/acknowledge", json={"note": f"{tag}: stopped by the benchmark"})


async def _begun(bench: _Bench, tag: str) -> str:
    bench.events[tag].clear()
    answer = await bench.client.post(
        "/tests/run", json={"valve": tag, "sequence": "triangle", "overrides": dict(_ORDER)}
    )
    assert answer.status_code == 202, answer.text

    async def moves() -> bool:
        happened = [event.happening for _, event in bench.events[tag]]
        return Happening.CAPTURE_STARTED in happened or happened.count(Happening.COMMANDED) > 3

    await _until(moves, _PATIENCE_S)
    return str(answer.json()["href"])


@asynccontextmanager
async def _watching(client: httpx.AsyncClient, test: str) -> AsyncIterator[None]:
    async with client.stream("GET", f"{test}/events", timeout=None) as stream:
        reading = asyncio.create_task(_read(stream))
        try:
            yield
        finally:
            reading.cancel()
            with contextlib.suppress(asyncio.CancelledError, httpx.HTTPError):
                await reading


async def _read(stream: httpx.Response) -> None:
    async for _ in stream.aiter_raw():
        pass


async def _stop(bench: _Bench, tag: str, test: str, after_s: float) -> None:
    await asyncio.sleep(after_s)
    asked_s = time.monotonic()
    moves = [
        event for _, event in bench.events[tag] if event.happening in (Happening.COMMANDED, Happening.CAPTURE_STARTED)
    ]
    if moves and _is_safe(moves[-1]):
        return  # a full disk ended it by its own rule before anybody pressed Stop
    answering = asyncio.create_task(bench.client.post(f"{test}/stop"))

    async def safe() -> bool:
        return any(at_s >= asked_s and _is_safe(event) for at_s, event in bench.events[tag])

    try:
        await _until(safe, _PATIENCE_S)
        bench.found_s.append(next(s for s, event in bench.events[tag] if s >= asked_s and _is_safe(event)) - asked_s)
    except TimeoutError:
        bench.found_s.append(math.inf)
    with contextlib.suppress(httpx.TransportError):
        answer = await answering
        bench.answers_s.append(time.monotonic() - asked_s if answer.is_success else math.inf)


def _is_safe(event: Event) -> bool:
    return event.happening is Happening.COMMANDED and event.pressure_pa == _SAFE_PA


async def _over(client: httpx.AsyncClient, test: str) -> bool:
    shown: dict[str, Any] = (await client.get(test)).json()
    return shown["state"] in {"stopped", "failed", "completed", "interrupted"}
