"""``breakaway check``: a plant file's faults, and what its devices show, without one byte that writes."""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.addresses import TcpAddress
from drivers.inspection import ReadOnlyTransport
from drivers.maps import register_map
from drivers.maps.reference import WatchdogState
from drivers.motion.bus_lock import BusLocks
from service.config.settings import load_plant
from simulator.faults import Fault as PlantFault
from simulator.faults import FaultKind
from tests.service.command_line import Called, called
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.reference_device import SPAN_PA, ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.wired_plant import TAG, wired_plant
from valve.errors import InternalError

READS = {3, 4}  # function codes


async def checked(path: Path, *more: str) -> Called:
    return await asyncio.to_thread(called, "check", "--config", str(path), *more)


async def seen(path: Path) -> tuple[int, dict[str, Any]]:
    """Check a plant live; the code and each valve by its tag."""
    answer = await checked(path, "--live", "--json")
    return answer.returncode, {one["tag"]: one for one in json.loads(answer.stdout)["valves"]}


def test_a_plant_file_without_a_fault_ends_with_0(plant_file: Path) -> None:
    answer = called("check", "--config", str(plant_file))
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout == f"{plant_file}: no fault: 2 valves, 2 buses, 0 schedules\n"
    document = json.loads(called("check", "--config", str(plant_file), "--json").stdout)
    assert document == {"file": str(plant_file), "right": True, "faults": []}


def test_every_fault_is_a_line_and_the_end_is_1(plant_file: Path, plant_text: str) -> None:
    text = plant_text.replace("prt", "port").replace("port = 5020", "prt = 5020").replace("0.1016", "-0.1")
    text = text.replace("timeout_s = 2.0", "timeout_s = 70.0")
    plant_file.write_text(text, encoding="utf-8")
    for more in ((), ("--live",)):
        answer = called("check", "--config", str(plant_file), *more)
        assert answer.returncode == 1
        assert [line.partition(" = ")[0].partition(": ")[2][:23] for line in answer.stdout.splitlines()] == [
            "buses[0].prt",
            "valves[0].actuator: act",
            "valves[1].actuator: act",
        ]
        assert len(answer.stderr.splitlines()) == 1
        assert "3 faults" in answer.stderr
        assert ("no device was read" in answer.stderr) is bool(more)
    answer = called("check", "--config", str(plant_file), "--json")
    document = json.loads(answer.stdout)
    assert (answer.returncode, document["right"], len(document["faults"])) == (1, False, 3)
    assert document["faults"][0] == {
        "file": "plant.toml",
        "key": "buses[0].prt",
        "value": "5020",
        "reason": "this key is unknown",
        "remedy": "write port",
        "message": "plant.toml: buses[0].prt = 5020: this key is unknown: write port",
    }


def test_a_file_that_is_no_toml_is_one_fault_and_one_without_config_is_wrong_usage(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text("[service", encoding="utf-8")
    answer = called("check", "--config", str(file))
    assert (answer.returncode, len(answer.stdout.splitlines())) == (1, 1)
    assert "no valid TOML" in answer.stdout
    assert called("check", "--config", str(tmp_path / "none.toml")).returncode == 1
    assert called("check").returncode == 2
    assert called("check", "--config", str(file), "--fix").returncode == 2


def test_what_the_simulator_alone_reads_is_checked_too(plant_file: Path, plant_text: str) -> None:
    text = plant_text.replace('parameter_set = "nominal"', 'parameter_set = "nominal"\nlagg_s = 0.1')
    plant_file.write_text(text.replace("port = 5020", "prt = 5020"), encoding="utf-8")
    answer = called("check", "--config", str(plant_file))
    assert answer.returncode == 1
    assert [line.partition(": ")[2].partition(" =")[0] for line in answer.stdout.splitlines()] == [
        "buses[0].prt",
        "valves[1].simulation.lagg_s",
    ]
    plant_file.write_text(text, encoding="utf-8")
    assert called("check", "--config", str(plant_file)).returncode == 1


async def test_a_live_plant_is_shown_and_no_valve_hears_a_write(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, plant):
        answer = await checked(path, "--live")
        assert answer.returncode == 0, answer.stdout + answer.stderr
        for said in (
            f"{TAG}: right",
            "reference device 1 on plc-1",
            "loop in manual",
            "owned by nobody",
            "watchdog off",
        ):
            assert said in answer.stdout
        code, valves = await seen(path)
        assert code == 0
        valve = valves[TAG]
        assert valve["devices"][0] | {"number": 1} == valve["devices"][0]
        assert abs(valve["position_m"]) < 0.001
        assert valve["position_percent"] == pytest.approx(100.0 * valve["position_m"] / 0.1016)
        assert valve["supply_pa"] == pytest.approx(140.0e3)
        assert [valve[key] for key in ("owner", "watchdog", "loop_in_manual", "interlock")] == [0, "off", True, False]
        assert {one["name"] for one in valve["permissives"]} >= {"device", "owner", "position", "watchdog"}
        from_s = plant.clock.now_s() + 0.05
        plant.inject(TAG, PlantFault(FaultKind.INTERLOCK, from_s))
        while plant.clock.now_s() < from_s:  # noqa: ASYNC110  - a clock sets no event
            await asyncio.sleep(0.01)
        answer = await checked(path, "--live")
        assert answer.returncode == 1
        assert "not right: no_interlock: active, no interlock is needed: clear the interlock" in answer.stdout
        assert answer.stderr == f"breakaway: 1 of 1 valves are not right: {TAG}: do what their lines say\n"
        assert plant.records[TAG].events == ()


def plant_of(folder: Path, ports: list[int], more: str = "") -> Path:
    """Write a plant of one valve a port, on the reference map."""
    path = folder / "plant.toml"
    valves = [
        valve_text(
            f"FV-{i}", f"b{i}", signal=False, pressure_pa=(0.0, SPAN_PA), mode="polled", period_s=0.05, more=more
        )
        for i in range(len(ports))
    ]
    buses = [bus_text(f"b{i}", port, "timeout_s = 1.0") for i, port in enumerate(ports)]
    path.write_text("".join([service_text(), *buses, *valves]), encoding="utf-8")
    return path


async def test_a_device_that_is_not_right_is_told_the_others_are_read_and_only_reading_functions_are_sent(
    quick_path: Path,
) -> None:
    slaves = [RawSlave() for _ in range(6)]
    devices = [ReferenceDevice(slave) for slave in slaves]
    _, silent, other, owned, automatic, sensor = devices
    silent.slave.always = Fault(drop=True)
    other.show(canary=12345)
    owned.show(run_owner=7, watchdog_state=WatchdogState.ARMED, watchdog_timeout=60.0)
    owned._fed_s = time.monotonic()
    automatic.status = 0
    sensor.position_m = lambda _: float("nan")
    ports = [TcpPort(slave) for slave in slaves]
    for port in ports:
        await port.__aenter__()
    try:
        code, valves = await seen(plant_of(quick_path, [port.port for port in ports]))
    finally:
        for port in ports:
            await port.__aexit__()
    assert code == 1
    faults = [" | ".join(valves[f"FV-{i}"]["faults"]) for i in range(6)]
    assert faults[0] == ""
    assert valves["FV-0"]["devices"] == [
        {"subject": "device 1 on b0", "map": "reference", "number": 77, "answers": True, "fault": ""}
    ]
    assert "bus b1: device 1, reading 2 words at 0: no answer within 1 s: check the device" in faults[1]
    assert valves["FV-1"]["devices"][0]["answers"] is False
    assert valves["FV-1"]["permissives"] == []
    assert "shows 12345 in canary, map reference expects 1113014617: another device answers" in faults[2]
    assert "owner: run 7, nobody is needed" in faults[3]
    assert (valves["FV-3"]["owner"], valves["FV-3"]["watchdog"]) == (7, "armed")
    assert "loop_in_manual: not in manual, the loop in manual is needed" in faults[4]
    assert valves["FV-4"]["loop_in_manual"] is False
    assert "device 1 on b5: position shows no valid position" in faults[5]
    assert valves["FV-5"]["position_m"] is None
    assert valves["FV-5"]["output_pa"] == 0.0
    sent = {request[1] for slave in slaves for request in slave.requests}
    assert sent <= READS
    assert all(device.moves == [] and device.slave.writes == [] for device in devices)


async def test_what_a_capture_has_no_room_for_is_told(quick_path: Path) -> None:
    device = ReferenceDevice(RawSlave())
    device.show(capture_capacity=1000)
    async with TcpPort(device.slave) as port:
        path = plant_of(quick_path, [port.port])
        text = path.read_text(encoding="utf-8").replace('"polled"\nperiod_s = 0.05', '"captured"\nperiod_s = 0.001')
        path.write_text(text, encoding="utf-8")
        code, valves = await seen(path)
    assert code == 1
    assert "samples, device 1 on b0 keeps 1000: make the test shorter" in valves["FV-0"]["faults"][0]
    assert {request[1] for request in device.slave.requests} <= READS


async def test_a_permit_is_asked_for_at_the_start_of_a_test_and_not_by_a_check(quick_path: Path) -> None:
    device = ReferenceDevice(RawSlave())
    device.status = 0
    async with TcpPort(device.slave) as port:
        path = plant_of(quick_path, [port.port], "[valves.permissives]\npermit = true\n")
        code, valves = await seen(path)
    assert (code, valves["FV-0"]["faults"]) == (0, [])


async def test_a_bus_that_a_test_uses_is_left_alone_and_told(quick_path: Path) -> None:
    device = ReferenceDevice(RawSlave())
    async with TcpPort(device.slave) as port:
        path = plant_of(quick_path, [port.port])
        async with BusLocks(load_plant(path).buses).hold(["b0"]):
            code, valves = await seen(path)
        assert code == 1
        assert "is used by another process" in valves["FV-0"]["faults"][0]
        assert device.slave.requests == []
        assert (await seen(path))[0] == 0  # and it gives back what it took


async def test_valves_of_another_gateway_are_left_to_it(quick_path: Path) -> None:
    slaves = [RawSlave(), RawSlave()]
    devices = [ReferenceDevice(slave) for slave in slaves]
    async with TcpPort(slaves[0]) as one, TcpPort(slaves[1]) as two:
        path = plant_of(quick_path, [one.port, two.port])
        text = path.read_text(encoding="utf-8").replace("[service]", '[service]\ngateway = "g1"', 1)
        for number in (0, 1):
            text = text.replace(f'name = "b{number}"', f'name = "b{number}"\ngateway = "g{number + 1}"', 1)
        text += "".join(f'[[gateways]]\nname = "g{i}"\nurl = "http://h{i}:8321"\n' for i in (1, 2))
        path.write_text(text, encoding="utf-8")
        answer = await checked(path, "--live")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "FV-1: gateway g2 drives it: check it there" in answer.stdout
    assert devices[1].slave.requests == []


async def test_a_check_cannot_write_even_if_it_wanted_to() -> None:
    bus = ReadOnlyTransport(TcpAddress("b", "127.0.0.1", 5020))
    for write in (bus.write(1, 34, [0, 0]), bus.read_write(1, 34, [0, 0], 0, 1)):
        with pytest.raises(InternalError, match="never may"):
            await write


def module_plant(folder: Path, ports: list[int], valves: int) -> Path:
    """Write a plant of I/O modules, as many units a port."""
    module = 'map = "advantech_adam_6024"\nsignal = [0.004, 0.02]\n'
    pressure_pa = (20_000.0, 100_000.0)
    parts = [service_text(), *(bus_text(f"b{i}", port, "timeout_s = 5.0") for i, port in enumerate(ports))]
    for number in range(valves):
        bus, unit = f"b{number % len(ports)}", 1 + number // len(ports)
        position = f'[valves.position]\nbus = "{bus}"\ndevice_id = {unit}\n{module}quantity = [0.0, 0.1016]\n'
        more = position + '[valves.watchdog]\nwaived = "none"\n[valves.permissives]\nmanual_waived = "none"\n'
        kept: dict[str, Any] = {"safe": "20000.0", "signal": False, "pressure_pa": pressure_pa}
        text = valve_text(f"FV-{number}", bus, unit, mode="polled", period_s=0.05, more=more, **kept)
        parts.append(text.replace('map = "reference"', f"{module}quantity = {list(pressure_pa)}", 1))
    path = folder / "plant.toml"
    path.write_text("".join(parts), encoding="utf-8")
    return path


async def test_a_broken_wire_that_reads_as_the_lower_end_is_told_by_the_status_of_its_input(quick_path: Path) -> None:
    slave, device = RawSlave(), register_map("advantech_adam_6024")
    for register in device.registers:
        slave.set_words(1, register.address, [0])
    slave.set_words(1, device.register("ai0_status").address, [2])
    async with TcpPort(slave) as port:
        code, valves = await seen(module_plant(quick_path, [port.port], 1))
    (fault,) = valves["FV-0"]["faults"]
    assert code == 1
    assert fault.startswith("device 1 on b0: ai0_status shows 2 (bits: 1 over high, 2 over low, 0 normal): ai0 is no")
    assert {request[1] for request in slave.requests} <= READS


async def test_a_silent_device_on_a_serial_line_is_told_and_its_neighbours_are_read_right(quick_path: Path) -> None:
    slave, device = RawSlave(), register_map("advantech_adam_6024")
    for unit in (1, 3):
        for register in device.registers:
            slave.set_words(unit, register.address, [0])
        slave.set_words(unit, 0, [10_000 * unit])
    async with SerialPort(slave, units=(1, 3)) as line:
        path = module_plant(quick_path, [1], 3)
        text = path.read_text(encoding="utf-8").replace(
            'kind = "modbus_tcp"\nhost = "127.0.0.1"\nport = 1\ntimeout_s = 5.0', "LINE"
        )
        rtu = f'kind = "modbus_rtu"\nserial_port = "{line.path}"\nparity = "N"\ntimeout_s = 0.5\nworst_latency_s = 1.0'
        path.write_text(text.replace("LINE", rtu), encoding="utf-8")
        code, valves = await seen(path)
    assert code == 1
    assert [valves[f"FV-{i}"]["right"] for i in range(3)] == [True, False, True]
    assert [valves[f"FV-{i}"]["position_percent"] for i in (0, 2)] == pytest.approx([1e6 / 65535, 3e6 / 65535])
    (fault,) = valves["FV-1"]["faults"]
    assert fault.startswith("bus b0: device 2, reading 1 words at 0: no answer within")
    assert {request[1] for request in slave.requests} <= READS


async def test_five_hundred_valves_are_checked_bus_beside_bus(quick_path: Path) -> None:
    slaves = [RawSlave() for _ in range(5)]
    device = register_map("advantech_adam_6024")
    for slave in slaves:
        for unit in range(1, 101):
            for register in device.registers:
                slave.set_words(unit, register.address, [0])
            slave.set_words(unit, 0, [1000])
    ports = [TcpPort(slave) for slave in slaves]
    for port in ports:
        await port.__aenter__()
    try:
        path = module_plant(quick_path, [port.port for port in ports], 500)
        begun_s = time.process_time()
        assert (await checked(path)).stdout == f"{path}: no fault: 500 valves, 5 buses, 0 schedules\n"
        assert time.process_time() - begun_s < 10.0, "1 s on an idle machine"
        code, valves = await seen(path)
    finally:
        for port in ports:
            await port.__aexit__()
    assert [valve["faults"] for valve in valves.values() if valve["faults"]] == []
    assert (code, len(valves)) == (0, 500)
    assert valves["FV-499"]["position_percent"] == pytest.approx(100.0 * 1000 / 65535)
    assert valves["FV-499"]["output_pa"] == pytest.approx(20_000.0)
    assert {request[1] for slave in slaves for request in slave.requests} <= READS
