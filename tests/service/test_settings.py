from __future__ import annotations

from pathlib import Path

import pytest

from drivers.addresses import GaugeAddress, TcpAddress
from service.settings import load_plant
from valve.errors import ConfigurationError


def test_a_plant_file_becomes_the_dataclasses_that_the_drivers_use(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    assert plant.service.store == plant_file.parent / "plant-data"
    assert isinstance(plant.buses["plc-1"], TcpAddress)
    assert isinstance(plant.buses["gauge-1"], GaugeAddress)
    first, second = plant.valves["FV-101"], plant.valves["FV-102"]
    assert first.nameplate.signal is not None
    assert first.nameplate.signal.range_pa == (0.0, 82737.0)
    assert first.wiring.watchdog.timeout_s == 2.0
    assert first.buses == {"plc-1"}
    assert second.wiring.safe_value_pa == "entry"
    assert second.buses == {"plc-1", "gauge-1"}


BAD = {
    "an unknown key, with the right spelling": (
        'kind = "modbus_tcp"\n',
        'kind = "modbus_tcp"\ntimeout = 0.5\n',
        ["plant.toml", "buses[0].timeout = 0.5", "unknown", "timeout_s"],
    ),
    "an unknown key far from all": (
        "[service]",
        "[service]\nqwerty = 1",
        ["service.qwerty = 1", "unknown", "known here"],
    ),
    "an unknown section": ("[service]", "[sarvice]\n[service]", ["sarvice", "unknown", "write service"]),
    "a number in quotes": (
        "travel_m = 0.1016",
        'travel_m = "4 inch"',
        ["actuator.travel_m", "4 inch", "without quotes"],
    ),
    "an impossible travel": ("travel_m = 0.1016", "travel_m = -0.1", ["valves[0].actuator", "-0.1 m", "above 0"]),
    "not a number": ("travel_m = 0.1016", "travel_m = nan", ["valves[0].actuator.travel_m", "finite"]),
    "a wrong unit": ("pattern = ", 'unit = "furlong"\npattern = ', ["buses[1]", "furlong", "mm"]),
    "a travel in mm": ("travel_m = 0.1016", "travel_m = 101.6", ["valves[0]", "FV-101", "101.6 m", "mm"]),
    "a pattern without a value": ("(?P<value>", "(", ["buses[1]", "gauge-1", "(?P<value>"]),
    "a register that cannot be written": (
        'map = "reference"',
        'map = "reference"\nregister = "position"',
        ["valves[0]", "FV-101", "position", "cannot be written"],
    ),
    "a missing key": ("safe_value_pa = 0.0\n", "", ["valves[0].safe_value_pa", "missing"]),
    "a safe value outside the limits": (
        "safe_value_pa = 0.0",
        "safe_value_pa = 90000.0",
        ["valves[0]", "FV-101", "90000 Pa", "82737 Pa"],
    ),
    "a safe value that is a word": (
        "safe_value_pa = 0.0",
        'safe_value_pa = "open"',
        ["safe_value_pa", '"open"', "entry"],
    ),
    "limits beyond the transducer": (
        "range_pa = [0.0, 82737.0]",
        "range_pa = [20000.0, 80000.0]",
        ["valves[0].limits.pressure_pa", "20000 to 80000 Pa", "inside"],
    ),
    "limits that fall": ("pressure_pa = [0.0, 82737.0]", "pressure_pa = [9.0, 1.0]", ["limits", "must rise"]),
    "a bus that does not exist": ('bus = "plc-1"', 'bus = "plc-9"', ["valves[0].command.bus", "plc-9", "plc-1"]),
    "a map that does not exist": (
        'map = "reference"',
        'map = "referense"',
        ["valves[0].command", "referense", "reference"],
    ),
    "a register that does not exist": (
        'map = "reference"',
        'map = "reference"\nregister = "ao99"',
        ["valves[0].command", "ao99"],
    ),
    "a valve on a gauge": ('bus = "plc-1"\ndevice_id = 1\nmap = "reference"', 'bus = "gauge-1"', ["command", "gauge"]),
    "two valves on one register": ("device_id = 2", "device_id = 1", ["valves[1].command", "FV-101", "same register"]),
    "two valves on one register, one by its name": (
        'device_id = 2\nmap = "reference"',
        'device_id = 1\nmap = "reference"\nregister = "command"',
        ["valves[1].command", "FV-101", "same register"],
    ),
    "two names for one line": (
        'name = "gauge-1"\nkind = "serial_gauge"',
        (
            'name = "line-1"\nkind = "modbus_rtu"\nserial_port = "/dev/../dev/null"\nbaud_rate = 9600\n[[buses]]\n'
            'name = "gauge-1"\nkind = "serial_gauge"'
        ),
        ["buses[2].serial_port", "/dev/null", "bus line-1 is there too", "use line-1 for both"],
    ),
    "two spellings of one host": (
        'name = "gauge-1"\nkind = "serial_gauge"',
        (
            'name = "plc-2"\nkind = "modbus_tcp"\nhost = "LocalHost."\nport = 5020\n[[buses]]\n'
            'name = "gauge-1"\nkind = "serial_gauge"'
        ),
        ["buses[1].port", "127.0.0.1:5020", "bus plc-1 is there too", "use plc-1 for both"],
    ),
    "the broadcast address": ("device_id = 1", "device_id = 0", ["valves[0].command", "device_id 0", "1 to 247"]),
    "one tag twice": ('tag = "FV-102"', 'tag = "FV-101"', ["valves[1].tag", "FV-101", "rename"]),
    "one bus name twice": ('name = "gauge-1"', 'name = "plc-1"', ["buses[1].name", "plc-1", "rename"]),
    "a kind of bus that does not exist": ('kind = "modbus_tcp"', 'kind = "profibus"', ["buses[0].kind", "profibus"]),
    "an open network": ('bind = "127.0.0.1"', 'bind = "0.0.0.0"', ["service.bind", "0.0.0.0", "trusted_network"]),
    "no address": ('bind = "127.0.0.1"', 'bind = "plant"', ["service.bind", "plant", "IP address"]),
    "no TOML": ("[service]", "[service", ["no valid TOML", "line 1"]),
    "a waiver beside a timeout": ("timeout_s = 2.0", 'timeout_s = 2.0\nwaived = "x"', ["valves[1].watchdog", "either"]),
}


@pytest.mark.parametrize(("old", "new", "expected"), BAD.values(), ids=list(BAD))
def test_a_bad_plant_file_is_refused_with_key_value_and_remedy(
    plant_file: Path, plant_text: str, old: str, new: str, expected: list[str]
) -> None:
    assert old in plant_text
    plant_file.write_text(plant_text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    for part in expected:
        assert part in str(caught.value)


def test_all_faults_of_a_file_are_told_at_once(plant_file: Path, plant_text: str) -> None:
    text = plant_text.replace("travel_m = 0.1016", "travel_m = 0.0").replace('host = "127.0.0.1"\n', "")
    plant_file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    assert len(str(caught.value).splitlines()) == 3


@pytest.mark.parametrize("written", ["nan", "inf", "true", '"open"', "[0.0]"])
def test_a_safe_value_that_is_none_is_one_fault(plant_file: Path, plant_text: str, written: str) -> None:
    text = plant_text.replace("safe_value_pa = 0.0", f"safe_value_pa = {written}", 1)
    plant_file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    said = str(caught.value)
    assert said.startswith("plant.toml: valves[0].safe_value_pa = ")
    assert said.endswith(': it is neither a pressure nor an order: give Pa, or "entry"')
    assert len(said.splitlines()) == 1


def test_a_missing_file_is_a_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load_plant(tmp_path / "absent.toml")


def test_an_open_network_that_is_trusted_is_accepted(plant_file: Path, plant_text: str) -> None:
    text = plant_text.replace('bind = "127.0.0.1"', 'bind = "0.0.0.0"\ntrusted_network = true')
    plant_file.write_text(text, encoding="utf-8")
    assert load_plant(plant_file).service.bind == "0.0.0.0"
