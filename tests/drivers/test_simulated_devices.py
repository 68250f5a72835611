"""Whole polled tests through each device map, on simulated valves that are served with these very maps."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.addresses import (
    GaugeAddress,
    Mode,
    MotionLimits,
    Parity,
    Point,
    RtuAddress,
    Sampling,
    TcpAddress,
    ValveWiring,
    WatchdogChoice,
)
from drivers.bus import Bus
from drivers.device import connect_valve
from drivers.maps import register_map
from drivers.outcome import Ended
from drivers.permissive_rules import PermissiveRules
from drivers.sequence import play_sequence
from drivers.serial_gauge import SerialGauge
from drivers.transport import Transport
from simulator.assembly import SimulatedChannel, SimulatedPlant, SimulatedUnit, reference_unit
from simulator.gauge import GaugeListener
from simulator.listeners import Listener, RtuListener, TcpListener
from simulator.record import Happening
from simulator.unit import Quantity
from tests.support.simulated_plants import RANGE_PA, valve
from valve.recording import Provenance, Recording
from valve.waveform import triangle

TAG = "FV-301"
MA = (0.004, 0.020)
TRAVEL_M = (0.0, 0.1016)
SAFE_PA = 10_000.0
LIMITS = MotionLimits(RANGE_PA, 60_000.0, 30.0)
WAIVED = WatchdogChoice(waived="the module has none")
WAVE = triangle(2.0, 1, 10_000.0, 60_000.0)
GAUGE_PATTERN = r"(?P<value>[-+]?\d+\.\d+) mm"


def channel(quantity: Quantity, device: str, register: str, quantity_span: tuple[float, float]) -> SimulatedChannel:
    entry = register_map(device).register(register)
    if entry.unit in ("A", "1"):
        unit = "m" if quantity is Quantity.POSITION else "Pa"
        entry = entry.spanning(MA if entry.unit == "A" else (0.0, 1.0), quantity_span, unit)
    return SimulatedChannel(TAG, quantity, entry)


def wiring(command: Point, position: Point | None, pressure: Point | None, watchdog: WatchdogChoice) -> ValveWiring:
    sampling, rules = Sampling(Mode.POLLED, 0.02), PermissiveRules(manual_waived="the bench has no loop")
    return ValveWiring(
        TAG, command, SAFE_PA, LIMITS, sampling, position, pressure, watchdog=watchdog, permissives=rules
    )


async def played(
    wired: ValveWiring, units: Mapping[str, Sequence[SimulatedUnit]], folder: Path
) -> tuple[Recording, SimulatedPlant]:
    """Serve ``units`` by bus (a TCP port, or a line where the name says so), play, and judge by the plant's record."""
    listeners: dict[Listener, Sequence[SimulatedUnit]] = {
        # two listeners for any free port of one host would be one
        RtuListener(folder / name) if name.startswith("line") else TcpListener(f"127.0.0.{number}"): on_it
        for number, (name, on_it) in enumerate(units.items(), start=1)
    }
    gauges = {GaugeListener(folder / "gauge", "?\r", GAUGE_PATTERN): TAG}
    plant = SimulatedPlant([valve(TAG)], listeners, gauges=gauges)
    buses: dict[str, Bus] = {
        "gauge": SerialGauge(GaugeAddress("gauge", str(folder / "gauge"), "?\r", GAUGE_PATTERN, parity=Parity.NONE))
    }
    async with AsyncExitStack() as stack:
        stack.push_async_callback(plant.stop)
        await plant.start()
        for name, address in zip(units, plant.addresses, strict=False):
            host, _, port = address.rpartition(":")
            serial = name.startswith("line")
            buses[name] = Transport(
                RtuAddress(name, address, 115200, Parity.NONE) if serial else TcpAddress(name, host, int(port))
            )
        for bus in buses.values():
            stack.push_async_callback(bus.close)
            await bus.open()
        outcome = await play_sequence(
            connect_valve(wired, buses),
            WAVE,
            mode=Mode.POLLED,
            period_s=0.02,
            run_number=5,
            stop=asyncio.Event(),
            on_samples=lambda _: None,
            on_progress=lambda _share, _phase: None,
            limits=LIMITS,
            provenance=Provenance(),
        )
        plant.look()
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    assert outcome.recording is not None
    return outcome.recording, plant


def judged(recording: Recording, plant: SimulatedPlant, resolution_m: float) -> None:
    track = plant.records[TAG].track
    stem_m = recording.position_m[np.isfinite(recording.position_m)]
    assert stem_m.size >= 20  # 81 on a machine with nothing else to do
    assert np.ptp(stem_m) > 0.02
    # every position that was recorded is one that the stem had when somebody looked
    distance_m = np.abs(stem_m[:, None] - track.position_m[None, :]).min(axis=1)
    assert distance_m.max() <= resolution_m
    assert track.asked_pa[-1] == pytest.approx(SAFE_PA, abs=25.0)
    assert recording.command_pa is not None
    commanded = [event.pressure_pa for event in plant.records[TAG].events if event.happening is Happening.COMMANDED]
    assert set(recording.command_pa[np.isfinite(recording.command_pa)]) <= {
        float(p) for p in commanded if p is not None
    }


async def test_an_adam_module_commands_and_senses(tmp_path: Path) -> None:
    name = "advantech_adam_6024"
    unit = SimulatedUnit(
        1,
        register_map(name),
        (
            channel(Quantity.COMMAND, name, "ao0", RANGE_PA),
            channel(Quantity.POSITION, name, "ai0", TRAVEL_M),
            channel(Quantity.PRESSURE, name, "ai1", RANGE_PA),
        ),
    )
    wired = wiring(
        Point("io", 1, name, "ao0", MA, RANGE_PA),
        Point("io", 1, name, "ai0", MA, TRAVEL_M),
        Point("io", 1, name, "ai1", MA, RANGE_PA),
        WAIVED,
    )
    recording, plant = await played(wired, {"io": [unit]}, tmp_path)
    judged(recording, plant, 4e-6)
    assert recording.pressure_pa is not None
    assert recording.command_pa is not None
    good = np.isfinite(recording.pressure_pa)
    assert recording.pressure_pa[good] == pytest.approx(recording.command_pa[good], abs=25.0)


async def test_a_moxa_pair_commands_by_one_module_and_senses_by_the_other(tmp_path: Path) -> None:
    command, sense = "moxa_iologik_e1241", "moxa_iologik_e1240"
    output = SimulatedUnit(
        1,
        register_map(command),
        (
            channel(Quantity.COMMAND, command, "ao0_raw", RANGE_PA),
            channel(Quantity.OUTPUT, command, "ao0", RANGE_PA),
        ),
    )
    inputs = SimulatedUnit(1, register_map(sense), (channel(Quantity.POSITION, sense, "ai0", TRAVEL_M),))
    wired = wiring(
        Point("out", 1, command, None, MA, RANGE_PA), Point("in", 1, sense, None, MA, TRAVEL_M), None, WAIVED
    )
    recording, plant = await played(wired, {"out": [output], "in": [inputs]}, tmp_path)
    judged(recording, plant, 4e-6)
    assert recording.pressure_pa is None


@pytest.mark.parametrize("name", ["fisher_easy_drive", "fisher_easy_drive_gen2"])
async def test_a_fisher_actuator_on_a_serial_line_shows_the_position_of_a_valve_that_is_commanded_elsewhere(
    tmp_path: Path, name: str
) -> None:
    sensing = SimulatedUnit(3, register_map(name), (channel(Quantity.POSITION, name, "position", TRAVEL_M),))
    commanding = replace(reference_unit(1, TAG), channels=reference_unit(1, TAG).channels[:1])
    wired = wiring(
        Point("plc", 1, "reference"),
        Point("line", 3, name, None, (0.0, 1.0), TRAVEL_M),
        None,
        WatchdogChoice(timeout_s=2.0),
    )
    recording, plant = await played(wired, {"plc": [commanding], "line": [sensing]}, tmp_path)
    judged(recording, plant, TRAVEL_M[1] * (0.006 if name == "fisher_easy_drive" else 0.0006))


async def test_a_gauge_shows_the_position_of_a_valve_that_is_commanded_over_tcp(tmp_path: Path) -> None:
    wired = wiring(Point("plc", 1, "reference"), Point("gauge"), None, WatchdogChoice(timeout_s=2.0))
    recording, plant = await played(wired, {"plc": [reference_unit(1, TAG, pressure=False)]}, tmp_path)
    judged(recording, plant, 2e-6)
    assert recording.pressure_pa is None
