"""Values that a plant file asks for and a device cannot hold: each is found before anything is opened."""

from __future__ import annotations

import struct
from dataclasses import replace

import pytest

from drivers.addresses import Mode, MotionLimits, Point, Sampling, TcpAddress, ValveWiring, WatchdogChoice
from drivers.device import connect_valve
from drivers.maps import REGISTER_MAPS, register_map
from drivers.observable import Misfit
from drivers.permissive_rules import Contact, PermissiveRules
from drivers.permissives import read_permissives
from drivers.registers import Kind
from drivers.representable import misfits, waveform_misfit
from drivers.stands_at import RestRules
from drivers.transport import Transport
from drivers.wiring import wire
from tests.support.slave import RawSlave
from valve.waveform import steps, triangle

BUSES = {"io": Transport(TcpAddress("io", "127.0.0.1"))}
MA = (0.004, 0.020)
LIMITS = MotionLimits((20_000.0, 100_000.0), 40_000.0, 300.0)
MODULE = ValveWiring(
    "FV-101",
    Point("io", 1, "advantech_adam_6024", signal=MA, quantity=(20_000.0, 100_000.0)),
    20_000.0,
    LIMITS,
    Sampling(Mode.POLLED, 0.05),
    position=Point("io", 1, "advantech_adam_6024", signal=MA, quantity=(0.0, 0.1)),
    watchdog=WatchdogChoice(waived="the module has none"),
    permissives=PermissiveRules(manual_waived="the bench has no loop"),
)
PLC = ValveWiring("FV-102", Point("io", 1, "reference"), 20_000.0, LIMITS, Sampling(Mode.CAPTURED, 0.001))


def found(wiring: ValveWiring) -> tuple[Misfit, ...]:
    return misfits(wiring, wire(wiring, BUSES))


@pytest.mark.parametrize("wiring", [MODULE, PLC, replace(MODULE, safe_value_pa="entry")])
def test_a_valve_whose_values_all_fit_has_no_misfit(wiring: ValveWiring) -> None:
    assert found(wiring) == ()


def on_module(**more: object) -> ValveWiring:
    return replace(MODULE, **more)  # type: ignore[arg-type]  # each case changes what it names


def on_plc(**more: object) -> ValveWiring:
    return replace(PLC, **more)  # type: ignore[arg-type]  # each case changes what it names


def with_rules(**more: object) -> ValveWiring:
    return replace(MODULE, permissives=PermissiveRules(manual_waived="x", **more))  # type: ignore[arg-type]


def contact(register: str, **how: float) -> Contact:
    return Contact("io", 1, "advantech_adam_6024", register, **how)  # type: ignore[arg-type]


WIDE = MotionLimits((0.0, 100_000.0), 40_000.0, 300.0)
CASES = {
    "a safe value below 4 mA": (
        on_module(limits=WIDE, safe_value_pa=0.0),
        "safe_value_pa",
        0.0,
        "ao0 of advantech_adam_6024 (device 1 on io) takes 20000 to 100000 Pa in steps of 19.54",
    ),
    "limits below 4 mA": (on_module(limits=WIDE), "limits.pressure_pa", [0.0, 100_000.0], "takes 20000 to 100000 Pa"),
    "limits above 20 mA": (
        on_module(limits=replace(LIMITS, pressure_pa=(20_000.0, 120_000.0))),
        "limits.pressure_pa",
        [20_000.0, 120_000.0],
        "takes 20000 to 100000 Pa",
    ),
    "limits that hardly have a step": (
        on_module(limits=replace(LIMITS, pressure_pa=(20_000.0, 20_200.0))),
        "limits.pressure_pa",
        [20_000.0, 20_200.0],
        "10.2 steps of 19.54 Pa",
    ),
    "a watchdog that the device has not": (
        on_module(watchdog=WatchdogChoice(timeout_s=2.0)),
        "watchdog.timeout_s",
        2.0,
        "map advantech_adam_6024 has no watchdog",
    ),
    "a watchdog's time beyond its register": (
        on_plc(watchdog=WatchdogChoice(timeout_s=70.0)),
        "watchdog.timeout_s",
        70.0,
        "watchdog_timeout of reference (device 1 on io) takes 0 to 65.535 s in steps of 0.001",
    ),
    "a watchdog's time that is rounded to off": (
        on_plc(watchdog=WatchdogChoice(timeout_s=0.0004)),
        "watchdog.timeout_s",
        0.0004,
        "0 is off",
    ),
    "a watchdog that trips between two samples": (
        on_plc(acquisition=Sampling(Mode.POLLED, 3.0), watchdog=WatchdogChoice(timeout_s=2.0)),
        "watchdog.timeout_s",
        2.0,
        "fed every 3 s",
    ),
    "a watchdog that trips between two looks": (
        on_plc(watchdog=WatchdogChoice(timeout_s=0.1)),
        "watchdog.timeout_s",
        0.1,
        "fed every 0.1 s",
    ),
    "a capture without a buffer": (
        on_module(acquisition=Sampling(Mode.CAPTURED, 0.001)),
        "acquisition.mode",
        "captured",
        "no capture buffer",
    ),
    "a period that is rounded to nothing": (
        on_plc(acquisition=Sampling(Mode.CAPTURED, 4.0e-7)),
        "acquisition.period_s",
        4.0e-7,
        "capture_period of reference (device 1 on io) takes 0 to 4294.967295 s in steps of 1e-06",
    ),
    "a period beyond its register": (
        on_plc(acquisition=Sampling(Mode.CAPTURED, 5000.0)),
        "acquisition.period_s",
        5000.0,
        "takes 0 to 4294.967295 s",
    ),
    "a test longer than a corner's time": (
        on_plc(limits=replace(LIMITS, longest_test_s=5000.0)),
        "limits.longest_test_s",
        5000.0,
        "counts 0 to 4294.967295 s",
    ),
    "a command beside the run number": (
        on_plc(command=Point("io", 1, "reference", "safe_value")),
        "command.register",
        "safe_value",
        "directly behind run_number, in command",
    ),
    "a scaling that the watchdog would not share": (
        on_plc(command=Point("io", 1, "reference", signal=(0.0, 100.0), quantity=(20_000.0, 100_000.0))),
        "command.quantity",
        None,
        "would not be scaled with it",
    ),
    "a device number that no device can show": (
        on_plc(permissives=PermissiveRules(device_number=2**32)),
        "permissives.device_number",
        2**32,
        "takes 0 to 4294967295",
    ),
    "a bit beyond its word": (
        with_rules(interlock=contact("ai3_status", bit=20)),
        "permissives.interlock.bit",
        20,
        "has bits 0 to 15",
    ),
    "a bit of a current": (with_rules(interlock=contact("ai3", bit=0)), "permissives.interlock.bit", 0, "no bits"),
    "a threshold in mA": (
        with_rules(interlock=contact("ai3", above=12.0)),
        "permissives.interlock.above",
        12.0,
        "shows 0.004 to 0.02 A: it would never say yes",
    ),
    "a threshold that is always passed": (
        with_rules(interlock=contact("ai3", below=1.0)),
        "permissives.interlock.below",
        1.0,
        "it would never say no",
    ),
    "a supply that nothing shows": (
        with_rules(supply_pa=(1.0e5, 2.0e5)),
        "permissives.supply_pa",
        [1.0e5, 2.0e5],
        "shows no air supply",
    ),
    "a supply that its sensor cannot reach": (
        with_rules(
            supply=Point("io", 1, "advantech_adam_6024", "ai2", signal=MA, quantity=(0.0, 1.0e6)),
            supply_pa=(2.0e6, 3.0e6),
        ),
        "permissives.supply_pa",
        [2.0e6, 3.0e6],
        "ai2 of advantech_adam_6024",
    ),
    "a position that its sensor cannot reach": (
        on_module(limits=replace(LIMITS, position_m=(1.0, 2.0))),
        "limits.position_m",
        [1.0, 2.0],
        "ai0 of advantech_adam_6024",
    ),
    "a stem that must be stiller than a step": (
        with_rules(still_m=1.0e-7),
        "permissives.still_m",
        1.0e-7,
        "steps of 1.526e-06: one step is more",
    ),
    "a band of less than a step": (
        on_module(limits=replace(LIMITS, band_m=1.0e-7)),
        "limits.band_m",
        1.0e-7,
        "one step is more",
    ),
    "a safe position that its sensor cannot reach": (
        on_module(rest=RestRules(-0.05, 0.002)),
        "safe_position_m",
        -0.05,
        "shows 0 to 0.1 m",
    ),
    "a safe position within less than a step": (
        on_module(rest=RestRules(0.0, 1.0e-7)),
        "safe_position_tolerance_m",
        1.0e-7,
        "one step is more",
    ),
    "a pressure in kPa": (
        on_module(pressure=Point("io", 1, "advantech_adam_6024", signal=MA, quantity=(0.0, 100.0))),
        "pressure.quantity",
        [0.0, 100.0],
        "ai1 of advantech_adam_6024 (device 1 on io) takes 0 to 100 Pa",
    ),
}


@pytest.mark.parametrize(("wiring", "key", "value", "said"), CASES.values(), ids=list(CASES))
def test_a_value_that_a_device_cannot_hold_is_told_with_what_it_can(
    wiring: ValveWiring, key: str, value: object, said: str
) -> None:
    all_of_it = found(wiring)
    matching = [one for one in all_of_it if ".".join(one.key) == key and one.value == value and said in one.reason]
    assert matching, all_of_it
    assert all(one.remedy for one in matching)


def test_both_faults_of_the_module_that_the_limits_go_beyond_are_told() -> None:
    wiring = on_module(limits=WIDE, safe_value_pa=0.0, watchdog=WatchdogChoice(timeout_s=70.0))
    assert [".".join(one.key) for one in found(wiring)] == ["limits.pressure_pa", "safe_value_pa", "watchdog.timeout_s"]


def test_rounding_by_less_than_half_a_step_is_no_misfit() -> None:
    assert found(on_module(limits=replace(LIMITS, pressure_pa=(19_991.0, 100_009.0)))) == ()
    assert found(on_module(limits=replace(LIMITS, pressure_pa=(19_989.0, 100_000.0)))) != ()


@pytest.mark.parametrize(("raw_range", "said"), [((8.0, 20.0), "ao0 of moxa_iologik_e1241"), (None, "")])
def test_an_output_that_its_read_back_cannot_show_is_a_misfit(
    monkeypatch: pytest.MonkeyPatch, raw_range: tuple[float, float] | None, said: str
) -> None:
    entry = register_map("moxa_iologik_e1241")
    registers = tuple(replace(one, raw_range=raw_range) if one.name == "ao0" else one for one in entry.registers)
    monkeypatch.setitem(REGISTER_MAPS, entry.name, replace(entry, registers=registers))
    command = Point("io", 2, "moxa_iologik_e1241", signal=MA, quantity=(20_000.0, 100_000.0))
    reasons = [one.reason for one in found(on_module(command=command))]
    assert [reason.startswith(said) and "shows 40000 to 100000 Pa" in reason for reason in reasons] == 2 * bool(
        said
    ) * [True]


def test_a_map_that_cannot_carry_a_run_number_is_a_misfit(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = register_map("reference")
    registers = tuple(replace(one, kind=Kind.F32) if one.name == "run_number" else one for one in entry.registers)
    monkeypatch.setitem(REGISTER_MAPS, "reference", replace(entry, registers=registers))
    (one,) = found(PLC)
    assert (one.key, one.value) == (("command", "map"), "reference")
    assert "run_number must hold 4294967295 exactly" in one.reason


def test_a_waveform_of_more_corners_than_the_device_counts_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = register_map("reference")
    registers = tuple(
        replace(one, raw_range=(0, 100)) if one.name == "corner_count" else one for one in entry.registers
    )
    monkeypatch.setitem(REGISTER_MAPS, "reference", replace(entry, registers=registers))
    wired = wire(PLC, BUSES)
    assert waveform_misfit(PLC, wired, triangle(20.0, 3, 20_000.0, 100_000.0)) == ""
    many = steps([20_000.0 + 10.0 * level for level in range(60)], 1.0)
    assert waveform_misfit(PLC, wired, many).startswith("it has 120 for corner_count, corner_count of reference")
    assert waveform_misfit(MODULE, wire(MODULE, BUSES), many) == ""


async def test_an_output_that_cannot_be_commanded_back_permits_no_test(tcp: Transport, slave: RawSlave) -> None:
    """An analog output may stand at 3.9 mA, which 0 to 4095 over 4 to 20 mA cannot say: no ramp can begin there."""
    output, module = register_map("moxa_iologik_e1241"), register_map("advantech_adam_6024")
    wiring = replace(
        MODULE,
        command=Point("plc", 1, output.name, signal=MA, quantity=(20_000.0, 100_000.0)),
        position=replace(MODULE.position, bus="plc", device_id=2) if MODULE.position is not None else None,
    )
    slave.set_words(1, output.register("ao0_raw").address, [0])
    slave.set_words(2, module.register("ai0").address, [30_000])
    judged = {}
    for milliamperes in (3.9, 4.0):
        for offset, word in enumerate(struct.unpack(">HH", struct.pack(">f", milliamperes))):
            slave.inputs[1, output.register("ao0").address + offset] = word
        readiness = await read_permissives(connect_valve(wiring, {"plc": tcp}))
        judged[milliamperes] = {one.name: one.met for one in readiness.permissives}["output"]
    assert judged == {3.9: False, 4.0: True}
    assert slave.writes == []
