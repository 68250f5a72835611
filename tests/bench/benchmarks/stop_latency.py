"""How long it takes from a stop to the write of the safe value, on real TCP to a simulated valve that is moving."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Iterator
from typing import Final

import numpy as np
from rich.table import Table

from drivers.addresses import MotionLimits, Point, Sampling, TcpAddress, ValveWiring, WatchdogChoice
from drivers.device import connect_valve
from drivers.outcome import Ended
from drivers.sequence import play_sequence
from drivers.transport import Transport
from simulator.assembly import SimulatedPlant, reference_unit
from simulator.listeners import TcpListener
from simulator.plant import warm_up
from simulator.record import Event, Happening
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Provenance
from valve.waveform import triangle

TESTS: Final = 1000
ASKED_S: Final = 0.05  # p99.9, without faults
_TAG: Final = "FV-1"
_SAFE_PA: Final = 12_345.0
_AT_ONCE: Final = 4
_LIMITS: Final = MotionLimits((0.0, 82_737.0), 200_000.0, 60.0)
_WIRING: Final = ValveWiring(
    _TAG,
    Point("bus", 1, "reference"),
    _SAFE_PA,
    _LIMITS,
    Sampling("polled", 0.02),  # type: ignore[arg-type]  # the text is turned into a Mode
    watchdog=WatchdogChoice(timeout_s=2.0),
)


def run(count: int | None) -> Table:
    """Stop so many tests in mid-motion, half of them polled and half captured, and return the table."""
    tests = TESTS if count is None else count
    warm_up()  # the simulated valves live in this process: what they compile is no part of a stop
    latencies = asyncio.run(_latencies(tests))
    table = Table(
        title=f"From a stop to the safe value on the wire, {tests} tests in each mode",
        caption=f"asked: p99.9 below {1e3 * ASKED_S:.0f} ms without faults; {_AT_ONCE} valves at once in one process, "
        "simulated devices and service on the same cores",
    )
    for name in ("mode", "median, ms", "p99, ms", "p99.9, ms", "longest, ms", "not safe"):
        table.add_column(name, justify="left" if name == "mode" else "right")
    for mode, found in latencies.items():
        seen = np.array([one for one in found if one is not None])
        shares = [f"{1e3 * np.quantile(seen, q):.1f}" for q in (0.5, 0.99, 0.999, 1.0)]
        table.add_row(mode, *shares, str(found.count(None)))
    return table


async def _latencies(tests: int) -> dict[str, list[float | None]]:
    found: dict[str, list[float | None]] = {"polled": [], "captured": []}
    for mode, into in found.items():
        waiting = iter(range(tests))
        await asyncio.gather(*(_stop_again_and_again(mode, waiting, into) for _ in range(_AT_ONCE)))
    return found


async def _stop_again_and_again(mode: str, waiting: Iterator[int], found: list[float | None]) -> None:
    chosen = PARAMETER_SETS["nominal"]
    valve = SimulatedValve(
        _TAG,
        chosen.parameters,
        chosen.nameplate,
        Transducer((0.0, 82_737.0)),
        Sensor((-0.005, 0.107)),
        Sensor((-4000.0, 87_000.0)),
    )
    plant = SimulatedPlant([valve], {TcpListener(): [reference_unit(1, _TAG)]})
    await plant.start()
    events: list[tuple[float, Event]] = []

    def keep(entry: Event | tuple[float, float, float, float]) -> None:
        if isinstance(entry, Event):
            events.append((time.monotonic(), entry))

    plant.records[_TAG].sink = keep
    try:
        for number in waiting:
            latency_s = await _stopped(plant, mode, number, events)
            found.append(latency_s)
    finally:
        await plant.stop()


async def _stopped(plant: SimulatedPlant, mode: str, number: int, events: list[tuple[float, Event]]) -> float | None:
    """Seconds from the stop to the write of the safe value; None where the valve was not read back there."""
    stop, stopped_s = asyncio.Event(), [0.0]
    chance = random.Random(number)

    def ask() -> None:
        stopped_s[0] = time.monotonic()
        stop.set()

    def on_progress(_share: float, phase: str) -> None:
        if phase == "playing" and stopped_s[0] == 0.0:
            stopped_s[0] = -1.0
            asyncio.get_running_loop().call_later(chance.uniform(0.0, 0.4), ask)

    bus = Transport(TcpAddress("bus", "127.0.0.1", int(plant.addresses[0].rpartition(":")[2]), timeout_s=5.0))
    await bus.open()
    events.clear()
    try:
        outcome = await play_sequence(
            connect_valve(_WIRING, {"bus": bus}),
            triangle(10.0, 1, 15_000.0, 60_000.0),
            mode=mode,
            period_s=0.02,
            run_number=number + 1,
            stop=stop,
            on_samples=lambda _: None,
            on_progress=on_progress,
            limits=_LIMITS,
            provenance=Provenance(),
        )
    finally:
        await bus.close()
    safe = [
        at_s
        for at_s, event in events
        if event.happening is Happening.COMMANDED and event.pressure_pa == _SAFE_PA and at_s >= stopped_s[0] > 0.0
    ]
    return safe[0] - stopped_s[0] if safe and outcome.safe_confirmed and outcome.ended is Ended.STOPPED else None
