from __future__ import annotations

import asyncio
import math
import os
import pty
import tty
from collections.abc import AsyncIterator
from dataclasses import replace

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
from drivers.device import connect_valve
from drivers.maps import register_map
from drivers.maps.reference import StatusBit
from drivers.outcome import Ended, SafeOutcome
from drivers.permissive_rules import PermissiveRules
from drivers.sequence import play_sequence
from drivers.serial_gauge import SerialGauge
from drivers.transport import Transport
from drivers.wiring import read_blocks
from tests.support.played_device import WIRING
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.stopwatch import Stopwatch
from valve.errors import ConfigurationError, DeviceError, WireError
from valve.recording import Provenance
from valve.waveform import triangle

SPAN_PA = 80_000.0
MA = (0.004, 0.020)
WAIVED = WatchdogChoice(waived="an analog module has none")
LIMITS = MotionLimits((0.0, SPAN_PA), 400_000.0, 30.0)
MODULE = ValveWiring(
    "FV-201",
    Point("io", 1, "advantech_adam_6024", signal=MA, quantity=(0.0, SPAN_PA)),
    0.0,
    LIMITS,
    Sampling(Mode.POLLED, 0.02),
    position=Point("io", 1, "advantech_adam_6024", "ai0", MA, (0.0, 0.1)),
    pressure=Point("io", 1, "advantech_adam_6024", "ai1", MA, (0.0, SPAN_PA)),
    watchdog=WAIVED,
    permissives=PermissiveRules(manual_waived="the bench has no loop"),
)


class Module:
    """An I/O module whose output drives a stem that follows at once."""

    def __init__(self, slave: RawSlave) -> None:
        self.slave = slave
        slave.holding.clear()
        slave.set_words(1, 0, [0] * 6)
        slave.set_words(1, 10, [0] * 2)
        slave.on_read = self.on_read

    @property
    def share(self) -> float:
        return self.slave.holding[1, 10] / 4095

    def on_read(self, _unit: int, _address: int, _count: int) -> None:
        self.slave.set_words(1, 0, [round(self.share * 65535)] * 2)


class Gauge:
    """Answers every request with the position of ``module``."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)
        asyncio.get_running_loop().add_reader(self.ours, self.heard)

    def heard(self) -> None:
        os.read(self.ours, 100)
        os.write(self.ours, f"{100.0 * self.module.share:+.4f} mm\r\n".encode())

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self.ours)
        os.close(self.ours)
        os.close(self.theirs)


@pytest.fixture
def module(slave: RawSlave) -> Module:
    return Module(slave)


@pytest.fixture
async def gauge(module: Module) -> AsyncIterator[SerialGauge]:
    fake = Gauge(module)
    entry = SerialGauge(GaugeAddress("gauge", fake.path, "?\r", r"(?P<value>[-+]?\d+\.\d+) mm"))
    await entry.open()
    yield entry
    await entry.close()
    fake.close()


async def played(wiring: ValveWiring, buses: dict[str, Transport | SerialGauge]) -> None:
    """Play a triangle and compare what was recorded with what the stem did."""
    device = connect_valve(wiring, buses)
    outcome = await play_sequence(
        device,
        triangle(0.6, 1, 8_000.0, 60_000.0),
        mode=Mode.POLLED,
        period_s=0.02,
        run_number=3,
        stop=asyncio.Event(),
        on_samples=lambda _: None,
        on_progress=lambda _share, _phase: None,
        limits=LIMITS,
        provenance=Provenance(),
    )
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    recording = outcome.recording
    assert recording is not None
    assert recording.command_pa is not None
    assert recording.samples >= 5
    assert recording.position_m == pytest.approx(recording.command_pa * 0.1 / SPAN_PA, abs=5e-6)
    assert (recording.pressure_pa is None) == (wiring.pressure is None)


async def test_an_io_module_commands_and_measures_in_milliamperes(module: Module, tcp: Transport) -> None:
    await played(MODULE, {"io": tcp})
    assert module.share == 0.0
    assert {len(words) for _, _, words in module.slave.writes} == {1}


async def test_a_valve_may_be_measured_by_a_gauge_on_another_bus_and_have_no_pressure(
    module: Module, tcp: Transport, gauge: SerialGauge
) -> None:
    await played(replace(MODULE, position=Point("gauge"), pressure=None), {"io": tcp, "gauge": gauge})


async def test_a_valve_may_be_spread_over_two_modbus_buses(module: Module, slave: RawSlave) -> None:
    async with TcpPort(slave) as port, SerialPort(slave) as line:
        first = Transport(TcpAddress("io", "127.0.0.1", port.port))
        second = Transport(RtuAddress("line", line.path, 115200, Parity.NONE))
        await first.open()
        await second.open()
        position = Point("line", 1, "advantech_adam_6024", "ai0", MA, (0.0, 0.1))
        await played(replace(MODULE, position=position, pressure=None), {"io": first, "line": second})
        await first.close()
        await second.close()


async def test_the_status_is_that_of_the_commanded_device_wherever_the_pressure_is(
    device: ReferenceDevice, tcp: Transport
) -> None:
    far = ReferenceDevice(RawSlave())
    device.status |= 1 << StatusBit.INTERLOCK
    far.output_pa = 33_000.0
    async with TcpPort(far.slave) as port:
        bus = Transport(TcpAddress("far", "127.0.0.1", port.port))
        await bus.open()
        wiring = replace(WIRING, pressure=Point("far", 1, "reference"))
        valve = connect_valve(wiring, {"bus": tcp, "far": bus})
        sample = await valve.read()
        await bus.close()
    assert sample.pressure_pa == 33_000.0
    assert sample.output_pa == device.output_pa
    assert await valve.interlocked(sample) is True


async def test_buses_are_asked_at_the_same_time(module: Module, tcp: Transport, gauge: SerialGauge) -> None:
    module.slave.always = Fault(delay_s=0.03)
    device = connect_valve(replace(MODULE, position=Point("gauge"), pressure=None), {"io": tcp, "gauge": gauge})
    watch = Stopwatch()
    await device.read()
    together_s, watch = watch.own_s, Stopwatch()
    await gauge.read()
    assert together_s < 0.03 + watch.own_s + 0.03


async def test_one_silent_bus_makes_a_gap_of_the_sample(module: Module, tcp: Transport, gauge: SerialGauge) -> None:
    device = connect_valve(replace(MODULE, position=Point("gauge"), pressure=None), {"io": tcp, "gauge": gauge})
    module.slave.faults.append(Fault(drop=True))
    with pytest.raises(WireError):
        await device.read()
    assert math.isfinite((await device.read()).position_m)


async def test_an_output_that_does_not_take_its_value_is_said(module: Module, tcp: Transport) -> None:
    module.slave.on_write = lambda _unit, _address, words: words.__setitem__(0, 0)
    with pytest.raises(DeviceError, match="does not show"):
        await connect_valve(MODULE, {"io": tcp}).command(40_000.0)
    assert len(module.slave.writes) == 1


async def test_a_device_without_a_watchdog_needs_a_waiver(module: Module, tcp: Transport) -> None:
    device = connect_valve(replace(MODULE, watchdog=WatchdogChoice(timeout_s=1.0)), {"io": tcp})
    with pytest.raises(ConfigurationError, match="waived"):
        await device.identify()


@pytest.mark.parametrize(("shown", "fits"), [(45964, "fisher_easy_drive"), (0, "fisher_easy_drive_gen2")])
async def test_the_generation_of_an_actuator_is_found_before_its_position_is_taken_ten_times_too_far(
    slave: RawSlave, tcp: Transport, rtu: Transport, shown: int, fits: str
) -> None:
    slave.holding[1, 8] = shown
    for name in ("fisher_easy_drive", "fisher_easy_drive_gen2"):
        wiring = replace(
            MODULE,
            position=Point("line", 1, name, signal=(0.0, 1.0), quantity=(0.0, 0.1)),
            pressure=None,
        )
        device = connect_valve(wiring, {"io": tcp, "line": rtu})
        if name == fits:
            assert fits in await device.identify()
        else:
            with pytest.raises(DeviceError, match="another device"):
                await device.identify()


async def test_a_safe_value_is_written_again_only_when_it_is_not_there(slave: RawSlave, tcp: Transport) -> None:
    reference = ReferenceDevice(slave)
    wiring = replace(MODULE, command=Point("io", 1, "reference"), position=None, pressure=None)
    device = connect_valve(replace(wiring, watchdog=WatchdogChoice(timeout_s=2.0)), {"io": tcp})
    await device.take_ownership(9)
    await device.command(30_000.0)
    slave.faults.append(Fault(drop=True))
    assert (await device.go_safe()).confirmed
    assert [pressure_pa for _, pressure_pa in reference.moves] == [30_000.0, 0.0]
    assert reference.output_pa == 0.0


async def test_a_dead_position_bus_does_not_hide_that_the_output_is_at_its_safe_value(
    module: Module, gauge: SerialGauge, tcp: Transport
) -> None:
    device = connect_valve(replace(MODULE, position=Point("gauge"), pressure=None), {"io": tcp, "gauge": gauge})
    await device.command(30_000.0)
    await gauge.close()
    assert await device.go_safe() == SafeOutcome(True, 0.0)
    assert module.share == 0.0


async def test_a_test_whose_position_bus_dies_ends_with_its_output_confirmed_at_the_safe_value(
    module: Module, gauge: SerialGauge, tcp: Transport
) -> None:
    device = connect_valve(replace(MODULE, position=Point("gauge"), pressure=None), {"io": tcp, "gauge": gauge})

    def die(_: float, phase: str) -> None:
        if phase == "playing":
            gauge._wanted = False

    outcome = await play_sequence(
        device,
        triangle(20.0, 1, 10_000.0, 60_000.0),
        mode="polled",
        period_s=0.02,
        run_number=3,
        stop=asyncio.Event(),
        on_samples=lambda _: None,
        on_progress=die,
        limits=LIMITS,
        provenance=Provenance(),
    )
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, True)
    assert "gauge" in str(outcome.error)
    assert module.share == 0.0


@pytest.mark.parametrize("safe_pa", [-20_000.0, 1.0e9, math.nan])
async def test_a_safe_value_that_the_device_cannot_take_is_said_and_raises_nothing(
    module: Module, tcp: Transport, safe_pa: float
) -> None:
    device = connect_valve(MODULE, {"io": tcp})
    await device.command(30_000.0)
    device.safe_value_pa = safe_pa
    found = await device.go_safe()
    assert not found.confirmed
    assert ("is outside" if math.isfinite(safe_pa) else "not known") in found.reason
    assert module.share > 0.0


async def test_whatever_fails_while_a_valve_is_made_safe_is_said_and_raises_nothing(
    module: Module, tcp: Transport, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = connect_valve(MODULE, {"io": tcp})

    async def broken(*_: object, **__: object) -> None:
        raise RuntimeError("a fault of ours")

    monkeypatch.setattr(device, "drive", broken)
    assert "a fault of ours" in (await device.go_safe()).reason
    monkeypatch.undo()
    await tcp.close()
    assert "closed" in (await device.go_safe()).reason


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"command": Point("nowhere", 1, "reference")}, "no bus is called"),
        ({"command": Point("gauge")}, "commands nothing"),
        ({"command": Point("io", 1, "advantech_adam_6024", "ai0", MA, (0.0, 1.0))}, "cannot be written"),
        ({"command": Point("io", 1, "advantech_adam_6024")}, "signal and quantity"),
        ({"command": Point("io", 1, "moxa_iologik_e1240")}, "no command of its own"),
        ({"command": Point("io", 1, "no_such_map")}, "unknown"),
        ({"command": Point("io", 1, "reference", "no_such_register")}, "no register"),
        ({"position": Point("io", 1, "moxa_iologik_e1241", signal=MA, quantity=(0.0, 1.0))}, "no position of its own"),
        ({"pressure": Point("gauge")}, "measures no pressure"),
        (
            {"command": Point("io", 1, "fisher_easy_drive", signal=(0.0, 1.0), quantity=(0.0, SPAN_PA))},
            "is a positioner.*command an I/P in pressure",
        ),
    ],
)
async def test_a_wiring_that_contradicts_itself_is_refused(
    tcp: Transport, gauge: SerialGauge, changes: dict[str, Point], match: str
) -> None:
    with pytest.raises(ConfigurationError, match=match):
        connect_valve(replace(MODULE, **changes), {"io": tcp, "gauge": gauge})  # type: ignore[arg-type]  # by name


async def test_registers_are_read_together_only_over_addresses_that_exist(tcp: Transport) -> None:
    unit = connect_valve(MODULE, {"io": tcp}).unit
    entry = register_map("advantech_adam_6024")
    blocks = read_blocks(unit, [entry.register(name) for name in ("ai0", "ai3", "ao0")])
    assert [(block.address, block.words) for block in blocks] == [(0, 4), (10, 1)]
