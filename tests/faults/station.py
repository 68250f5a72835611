"""One simulated valve behind a faulty wire, the plant file of a service that drives it, and its own record."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from drivers.registers import Table
from simulator.assembly import SimulatedPlant, reference_unit
from simulator.listeners import RtuListener, TcpListener
from simulator.record import Event
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from tests.faults.proxy import FaultyWire, LineProxy, TcpProxy
from tests.faults.wire_faults import FaultAt
from tests.plants import service_text, valve_text
from valve.parameter_sets import PARAMETER_SETS

TAG: Final = "FV-1"
SAFE_PA: Final = 20_000.0
WATCHDOG_S: Final = 1.0
TIMEOUT_S: Final = 0.25
POSITION: Final = Sensor((-0.005, 0.107))
PRESSURE: Final = Sensor((-4000.0, 87000.0))
Carrier = Literal["tcp", "rtu"]
Mode = Literal["polled", "captured"]
ORDER: Final = {
    "valve": TAG,
    "sequence": "triangle",
    "overrides": {"cycles": 1, "period_s": 1.0, "low_pa": 20_000.0, "high_pa": 60_000.0},
}


@dataclass
class Station:
    """What a judge looks at: ``looks`` are (monotonic s, position m, pressure Pa, asked Pa) and ``events``."""

    plant: SimulatedPlant
    wire: FaultyWire
    plant_file: Path
    mode: Mode
    looks: list[tuple[float, float, float, float]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)

    def keep(self, entry: Event | tuple[float, float, float, float]) -> None:
        now_s = time.monotonic()
        if isinstance(entry, Event):
            self.events.append((now_s, entry))
        else:
            self.looks.append((now_s, *entry[1:]))

    @property
    def asked_pa(self) -> float:
        """What the device asks of its I/P now, Pa."""
        self.plant.look()
        return self.looks[-1][3]

    async def until_safe(self, within_s: float) -> bool:
        """Wait until the device drives the safe value."""
        until_s = time.monotonic() + within_s
        while abs(self.asked_pa - SAFE_PA) > 100.0:
            if time.monotonic() > until_s:
                return False
            await asyncio.sleep(0.02)
        return True

    def read(self, address: int, count: int) -> list[int]:
        """Words of the device, past the wire."""
        return self.plant.slaves[0]._bus.read(1, Table.HOLDING, address, count)

    def write(self, address: int, words: list[int]) -> None:
        """Write to the device, past the wire."""
        self.plant.slaves[0]._bus.write(1, address, words)


@asynccontextmanager
async def station(
    folder: Path, carrier: Carrier, mode: Mode, fault: FaultAt | None, on_fault: Callable[[], Any] = lambda: None
) -> AsyncIterator[Station]:
    """Serve one valve; the service reaches it through the wire with the fault."""
    wire = FaultyWire(fault, on_fault)
    chosen = PARAMETER_SETS["nominal"]
    valve = SimulatedValve(
        TAG, chosen.parameters, chosen.nameplate, Transducer((0.0, 82737.0)), POSITION, PRESSURE, start_pa=SAFE_PA
    )
    listener = TcpListener() if carrier == "tcp" else RtuListener(folder / "devices")
    plant = SimulatedPlant([valve], {listener: [reference_unit(1, TAG)]})
    found = Station(plant, wire, folder / "plant.toml", mode)
    plant.records[TAG].sink = found.keep
    await plant.start(look_every_s=0.05)
    proxy: TcpProxy | LineProxy
    if carrier == "tcp":
        proxy = TcpProxy(wire, int(plant.addresses[0].rpartition(":")[2]))
        bus = f'kind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {await proxy.start()}\n'
    else:
        proxy = LineProxy(wire, folder / "line", folder / "devices")
        bus = f'kind = "modbus_rtu"\nserial_port = "{folder / "line"}"\nbaud_rate = 115200\nparity = "N"\n'
        bus += "worst_latency_s = 0.7\n"
    found.plant_file.write_text(_plant_text(bus, mode), encoding="utf-8")
    try:
        yield found
    finally:
        await proxy.stop()
        await plant.stop()


def _plant_text(bus: str, mode: Mode) -> str:
    line = f'[[buses]]\nname = "bus"\n{bus}timeout_s = {TIMEOUT_S}\n'
    valve = valve_text(
        TAG,
        "bus",
        safe=str(SAFE_PA),
        rate_pa_per_s=100000.0,
        mode=mode,
        period_s=0.04 if mode == "polled" else 0.002,
        watchdog_s=WATCHDOG_S,
    )
    return service_text(store="store") + line + valve
