"""A simulated plant on a TCP port, and the plant file of a service that drives it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

from simulator.assembly import SimulatedPlant, reference_unit
from simulator.clock import RunningClock
from simulator.faults import Fault
from simulator.listeners import TcpListener
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from tests.support.plants import bus_text, service_text, valve_text
from valve.effects import Effect
from valve.parameter_sets import PARAMETER_SETS

TAG = "FV-101"
SAFE_PA = 20_000.0


def standing_valve(start_pa: float, *faults: Fault) -> SimulatedValve:
    """Return the nominal valve as it stands at ``start_pa``, with faults of its own."""
    chosen = PARAMETER_SETS["nominal"]
    return SimulatedValve(
        TAG,
        chosen.parameters,
        chosen.nameplate,
        Transducer((0.0, 82737.0)),
        Sensor((-0.005, 0.107)),
        Sensor((-4000.0, 87000.0)),
        start_pa=start_pa,
        faults=faults,
    )


@asynccontextmanager
async def wired_plant(
    folder: Path,
    *,
    mode: str = "polled",
    period_s: float = 0.01,
    speed: float = 1.0,
    watchdog_s: float = 2.0,
    safe: str = str(SAFE_PA),
    port: int = 0,
    parameter_set: str = "nominal",
    effects: tuple[Effect, ...] = (),
    position_noise_m: float = 0.0,
    valve: SimulatedValve | None = None,
    more: str = "",
) -> AsyncIterator[tuple[Path, SimulatedPlant]]:
    """Serve one valve, nominal and without hidden effects by default, and hand out the plant file and the plant.

    ``valve`` stands in place of set, effects and noise; it is served as TAG. ``more`` are further tables of it.
    """
    chosen = PARAMETER_SETS[parameter_set]
    if valve is None:
        valve = SimulatedValve(
            TAG,
            chosen.parameters,
            chosen.nameplate,
            Transducer((0.0, 82737.0)),
            Sensor((-0.005, 0.107), position_noise_m),
            Sensor((-4000.0, 87000.0)),
            effects=effects,
        )
    valve = replace(valve, tag=TAG)
    listener = TcpListener(port=port)
    plant = SimulatedPlant([valve], {listener: [reference_unit(1, TAG)]}, RunningClock(speed))
    await plant.start(look_every_s=0.01)
    actuator, signal = valve.nameplate.actuator, valve.nameplate.signal
    assert signal is not None
    assert actuator.diaphragm_area_m2 is not None
    path = folder / "plant.toml"
    valve_part = valve_text(
        TAG,
        "plc-1",
        safe=safe,
        actuator=(actuator.diaphragm_area_m2, actuator.travel_m),
        pressure_pa=signal.range_pa,
        rate_pa_per_s=60000.0,
        mode=mode,
        period_s=period_s,
        watchdog_s=watchdog_s,
        more=more,
    )
    bus = bus_text("plc-1", plant.addresses[0].rpartition(":")[2], "timeout_s = 2.0")
    path.write_text(service_text() + bus + valve_part, encoding="utf-8")
    try:
        yield path, plant
    finally:
        await plant.stop()


def asked_pa(plant: SimulatedPlant) -> float:
    """Return what the simulated device asks of its I/P now, Pa."""
    plant.look()
    return float(plant.records[TAG].track.asked_pa[-1])
