"""The plant of the demonstration: which valves, on which wires, and its plant.toml."""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from valve.parameter_sets import PARAMETER_SETS


@dataclass(frozen=True, slots=True)
class DemoValve:
    """One valve of the demonstration."""

    tag: str
    parameter_set: str
    transport: Literal["tcp", "rtu"]
    mode: Literal["captured", "polled"]
    period_s: float
    seed: int
    position_noise_m: float


# Three captured at 1 ms with a usual position sensor. The RTU valve is polled at a rate that its line can carry: it
# shows what such data cannot give.
DEMO_VALVES: Final = (
    DemoValve("FV-101", "vendor", "tcp", "captured", 0.001, seed=101, position_noise_m=5.0e-6),
    DemoValve("FV-102", "nominal", "tcp", "captured", 0.001, seed=102, position_noise_m=5.0e-6),
    DemoValve("FV-103", "rough", "tcp", "captured", 0.001, seed=103, position_noise_m=5.0e-6),
    DemoValve("FV-104", "nominal", "rtu", "polled", 0.02, seed=104, position_noise_m=2.0e-6),
)


def free_ports(count: int) -> list[int]:
    """Distinct TCP ports of the loopback interface that nobody listens on at this moment."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [int(listener.getsockname()[1]) for listener in sockets]
    for listener in sockets:
        listener.close()
    return ports


def _bus(valve: DemoValve, port: int, folder: Path) -> str:
    if valve.transport == "tcp":
        return f'kind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}\n'
    path = json.dumps(str(folder / f"line-{valve.tag}"))
    return f'kind = "modbus_rtu"\nserial_port = {path}\nbaud_rate = 115200\nparity = "N"\n'


def _valve(valve: DemoValve) -> str:
    plate = PARAMETER_SETS[valve.parameter_set].nameplate
    actuator, signal = plate.actuator, plate.signal
    assert signal is not None, f"{valve.parameter_set} has no signal range"
    low_pa, high_pa = signal.range_pa
    return f"""
[[valves]]
tag = "{valve.tag}"
safe_value_pa = {low_pa}
[valves.actuator]
diaphragm_area_m2 = {actuator.diaphragm_area_m2}
travel_m = {actuator.travel_m}
[valves.signal]
range_ma = {list(signal.range_ma)}
range_pa = {list(signal.range_pa)}
[valves.limits]
pressure_pa = {list(signal.range_pa)}
pressure_rate_pa_per_s = {(high_pa - low_pa) / 2.0}
longest_test_s = 300.0
[valves.command]
bus = "bus-{valve.tag}"
device_id = 1
map = "reference"
[valves.acquisition]
mode = "{valve.mode}"
period_s = {valve.period_s}
[valves.watchdog]
timeout_s = 2.0
[valves.simulation]
parameter_set = "{valve.parameter_set}"
position_noise_m = {valve.position_noise_m}
seed = {valve.seed}
"""


def write_demo_plant(folder: Path) -> Path:
    """Write the demonstration's plant.toml into ``folder`` and return its path."""
    service_port, *bus_ports = free_ports(1 + len(DEMO_VALVES))
    text = f'[service]\nstore = "store"\nbind = "127.0.0.1"\nport = {service_port}\n'
    for valve, port in zip(DEMO_VALVES, bus_ports, strict=True):
        text += f'\n[[buses]]\nname = "bus-{valve.tag}"\n{_bus(valve, port, folder)}'
    for valve in DEMO_VALVES:
        text += _valve(valve)
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path
