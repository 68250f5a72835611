"""The plant of the demonstration: which valves, on which wires, and its plant.toml."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from valve.parameter_sets import PARAMETER_SETS


@dataclass(frozen=True, slots=True)
class DemoValve:
    """One valve of the demonstration: of a published set, with a usual packing, and with ``cause`` hidden in it."""

    tag: str
    parameter_set: str
    transport: Literal["tcp", "rtu"]
    mode: Literal["captured", "polled"]
    period_s: float
    seed: int
    cause: str | None = None
    effect: Mapping[str, float] = field(default_factory=dict)

    def true_parameters(self, told: Mapping[str, float], swept_m: Sequence[float] | None) -> dict[str, float]:
        """Return what an estimate is judged by: what the plant told, with what a tight spot adds to F_c on average.

        ``swept_m``: lowest and highest position of the test, m; None where it did not move.
        """
        truth = dict(told)
        if self.cause == _TIGHT_SPOT and swept_m is not None and swept_m[1] > swept_m[0]:
            rise_n, centre_m, width_m = (self.effect[name] for name in ("rise_n", "centre_m", "width_m"))
            low, high = (math.erf((end - centre_m) / (math.sqrt(2.0) * width_m)) for end in swept_m)
            truth["F_c"] += rise_n * width_m * math.sqrt(0.5 * math.pi) * (high - low) / (swept_m[1] - swept_m[0])
        return truth


_TIGHT_SPOT: Final = "local_friction"
_STARVED: Final = "supply_saturation"
# Captured at 1 ms, all with a usual packing and the sensors that go with it. The RTU valve is polled at a rate that
# its line can carry: it shows what such data cannot give. Two have a fault: a tight spot in the middle of the travel,
# 40 % of the friction there, and a supply that ends at 80 % of the full force.
DEMO_VALVES: Final = (
    DemoValve("FV-101", "vendor", "tcp", "captured", 0.001, seed=101),
    DemoValve("FV-102", "nominal", "tcp", "captured", 0.001, seed=102),
    DemoValve("FV-103", "rough", "tcp", "captured", 0.001, seed=103),
    DemoValve("FV-104", "nominal", "rtu", "polled", 0.02, seed=104),
    DemoValve(
        "FV-105", "nominal", "tcp", "captured", 0.001, seed=105,
        cause=_TIGHT_SPOT, effect={"rise_n": 800.0, "centre_m": 0.05, "width_m": 0.003},
    ),
    DemoValve("FV-106", "nominal", "tcp", "captured", 0.001, seed=106, cause=_STARVED, effect={"limit_n": 4270.0}),
)  # fmt: skip


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
# The published valves as they were: their packings take up to four fifths of the signal, and that is known.
[valves.health]
travel_end_percent = 50
dead_band_percent = 96
friction_share_percent = 50
breakaway_share_percent = 95
[valves.simulation]
parameter_set = "{valve.parameter_set}"
seed = {valve.seed}
[valves.simulation.packing]
preset = "usual"
{_effect(valve)}"""


def _effect(valve: DemoValve) -> str:
    """What a faulty valve hides, as the plant file has it."""
    if valve.cause is None:
        return ""
    values = "".join(f"{name} = {value}\n" for name, value in valve.effect.items())
    return f'[[valves.simulation.effects]]\ncause = "{valve.cause}"\n{values}'


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
