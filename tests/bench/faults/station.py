"""One simulated valve behind a faulty wire, the plant file of a service that drives it, and its own record."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from drivers.registers import Table
from simulator.assembly import SimulatedPlant, SimulatedUnit, reference_unit
from simulator.listeners import Listener, RtuListener, TcpListener
from simulator.record import Event
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from tests.bench.faults.proxy import FaultyWire, LineProxy, TcpProxy
from tests.bench.faults.surroundings import GAUGE_HOST, Surroundings, gauge_text, gauge_unit
from tests.bench.faults.wire_faults import FaultAt, PlantFault, ServiceFault
from tests.support.plants import service_text, valve_text
from valve.parameter_sets import PARAMETER_SETS

TAG: Final = "FV-1"
SAFE_PA: Final = 20_000.0
WATCHDOG_S: Final = 1.0
TIMEOUT_S: Final = 0.25
_PATIENT_TIMEOUT_S: Final = 1.0  # where the valve's own wire is well: what a busy machine holds up is no fault of it
_STOPPED_WATCHDOG_S: Final = 5.0  # where Stop is pressed: it must be the stop that reaches the valve
SAFE_M: Final = 0.0516  # where a nominal stem rests that came down to the safe value
TOLERANCE_M: Final = 0.02  # one that stays at the top of the stroke is 22 mm away
WITHIN_M: Final = (0.0, 0.09)  # limits of the stem, where a case needs them: what jumps is beyond
POSITION: Final = Sensor((-0.005, 0.107))
PRESSURE: Final = Sensor((-4000.0, 87000.0))
Carrier = Literal["tcp", "rtu"]
Mode = Literal["polled", "captured"]
ORDER: Final = {
    "valve": TAG,
    "sequence": "triangle",
    "overrides": {"cycles": 1, "period_s": 1.0, "low_pa": 20_000.0, "high_pa": 60_000.0},
}

#: Where a fault takes a while to be heeded: five strokes over more of the range.
LONG_ORDER: Final = {
    **ORDER,
    "overrides": {"cycles": 5, "period_s": 1.0, "low_pa": 20_000.0, "high_pa": 82_000.0},
}


@dataclass
class Station:
    """What a judge looks at: ``looks`` are (monotonic s, position m, pressure Pa, asked Pa) and ``events``."""

    plant: SimulatedPlant
    wire: FaultyWire
    plant_file: Path
    mode: Mode
    around: Surroundings
    struck_s: float = math.inf  # when the fault came, monotonic
    looks: list[tuple[float, float, float, float]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)

    def keep(self, entry: Event | tuple[float, float, float, float]) -> None:
        now_s = time.monotonic()
        if isinstance(entry, Event):
            self.events.append((now_s, entry))
        else:
            self.looks.append((now_s, *entry[1:]))

    @property
    def asked_to_end(self) -> bool:
        """Whether what moves the valve was asked to end by a signal, which it hears: it must see to it first."""
        fault = self.wire.fault
        return fault is not None and fault.fault in (ServiceFault.TERM, ServiceFault.HANG_UP)

    @property
    def outlives_its_service(self) -> bool:
        """Whether the service ended and what moves the valve did not: the test must go on."""
        fault = self.wire.fault
        return fault is not None and fault.fault in (ServiceFault.KILL_SERVICE, ServiceFault.TERM_SERVICE)

    @property
    def is_watched(self) -> bool:
        """Whether the test runs through the whole service, for a person with a session."""
        return self.wire.fault is not None and self.wire.fault.fault is ServiceFault.IDLE_SESSION

    @property
    def may_die_early(self) -> bool:
        """Whether the service may have ended before it took the test."""
        fault = self.wire.fault
        return fault is not None and (isinstance(fault.fault, ServiceFault) or fault.fault is PlantFault.DARK_DATABASE)

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
    of_plant = fault.fault if fault is not None and isinstance(fault.fault, PlantFault) else None
    around = Surroundings(of_plant, TAG)

    def strike() -> None:
        found.struck_s = time.monotonic()
        around.strike()
        on_fault()

    wire = FaultyWire(fault, strike)
    chosen = PARAMETER_SETS["nominal"]
    valve = SimulatedValve(
        TAG, chosen.parameters, chosen.nameplate, Transducer((0.0, 82737.0)), POSITION, PRESSURE, start_pa=SAFE_PA
    )
    listener = TcpListener() if carrier == "tcp" else RtuListener(folder / "devices")
    units: dict[Listener, list[SimulatedUnit]] = {listener: [reference_unit(1, TAG)]}
    if of_plant is PlantFault.DEAD_GAUGE:
        units[TcpListener(GAUGE_HOST)] = [gauge_unit(TAG, POSITION.span)]
    plant = SimulatedPlant([valve], units)
    around.plant = plant
    found = Station(plant, wire, folder / "plant.toml", mode, around)
    plant.records[TAG].sink = found.keep
    async with AsyncExitStack() as stack:
        await plant.start(look_every_s=0.05)
        stack.push_async_callback(plant.stop)
        if carrier == "tcp":
            tcp = TcpProxy(wire, int(plant.addresses[0].rpartition(":")[2]))
            stack.push_async_callback(tcp.stop)
            bus = f'kind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {await tcp.start()}\n'
        else:
            stack.push_async_callback(LineProxy(wire, folder / "line", folder / "devices").stop)
            bus = f'kind = "modbus_rtu"\nserial_port = "{folder / "line"}"\nbaud_rate = 115200\nparity = "N"\n'
            bus += "worst_latency_s = 0.7\n"
        await around.set_up(stack, folder)
        found.plant_file.write_text(_plant_text(bus, mode, around, is_watched=found.is_watched), encoding="utf-8")
        yield found


def _plant_text(bus: str, mode: Mode, around: Surroundings, *, is_watched: bool) -> str:
    timeout_s = TIMEOUT_S if around.fault is None else _PATIENT_TIMEOUT_S
    judged = f"safe_position_m = {SAFE_M}\nsafe_position_tolerance_m = {TOLERANCE_M}\nstem_read_after_s = 0.3"
    line = f'[[buses]]\nname = "bus"\n{bus}timeout_s = {timeout_s}\n{around.buses}'
    valve = valve_text(
        TAG,
        "bus",
        safe=str(SAFE_PA),
        rate_pa_per_s=150000.0,
        mode=mode,
        period_s=0.04 if mode == "polled" else 0.002,
        watchdog_s=_STOPPED_WATCHDOG_S if is_watched or around.fault is PlantFault.DARK_DATABASE else WATCHDOG_S,
        stem="stem_read_after_s = 0.0" if around.fault is None else judged,
        more=around.permissives + (gauge_text(POSITION.span) if around.fault is PlantFault.DEAD_GAUGE else ""),
    )
    if around.fault is PlantFault.FLAPPING:
        valve = valve.replace("[valves.limits]\n", f"[valves.limits]\nposition_m = {list(WITHIN_M)}\n")
    access = 'access = "sign-in"\n' if is_watched else ""
    database = f'database = "{around.database}"' if around.database else ""
    return service_text(access + database, store="store") + line + valve
