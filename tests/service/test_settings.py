from __future__ import annotations

from pathlib import Path

import pytest

from drivers.addresses import GaugeAddress, RtuAddress, TcpAddress
from service.config.settings import load_plant
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


def test_a_serial_line_may_be_said_to_echo(plant_file: Path, plant_text: str) -> None:
    line = '[[buses]]\nname = "line-1"\nkind = "modbus_rtu"\nserial_port = "/dev/ttyUSB0"\n'
    for more, echo in (("", False), ("echo = true\n", True)):
        plant_file.write_text(plant_text.replace("[[valves]]", f"{line}{more}[[valves]]", 1), encoding="utf-8")
        bus = load_plant(plant_file).buses["line-1"]
        assert isinstance(bus, RtuAddress)
        assert bus.echo is echo


BAD = {
    "an echo on a network": (
        'kind = "modbus_tcp"\n',
        'kind = "modbus_tcp"\necho = true\n',
        ["buses[0].echo", "unknown"],
    ),
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
        ["actuator.travel_m", "4 inch", "without quotes", 'or write travel = "4 inch"'],
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
    "a device id that no network has": ("device_id = 1", "device_id = 250", ["valves[0].command", "250", "255"]),
    "a device id that is no byte": ("device_id = 1", "device_id = 300", ["valves[0].command", "300", "0 to 255"]),
    "a watchdog beyond its register": (
        "timeout_s = 2.0",
        "timeout_s = 70.0",
        ["valves[1].watchdog.timeout_s = 70.0", "watchdog_timeout", "0 to 65.535 s in steps of 0.001", "choose"],
    ),
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


ON_MODULE = """\
[service]
store = "s"
[[buses]]
name = "io-1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = 5021
[[valves]]
tag = "FV-201"
safe_value_pa = 0.0
[valves.actuator]
travel_m = 0.1
[valves.limits]
pressure_pa = [0.0, 100000.0]
pressure_rate_pa_per_s = 4000.0
longest_test_s = 300.0
[valves.command]
bus = "io-1"
device_id = 1
map = "advantech_adam_6024"
signal = [0.004, 0.02]
quantity = [20000.0, 100000.0]
[valves.position]
bus = "io-1"
device_id = 1
map = "advantech_adam_6024"
signal = [0.004, 0.02]
quantity = [0.0, 0.1]
[valves.acquisition]
mode = "captured"
period_s = 0.05
[valves.watchdog]
timeout_s = 70.0
[valves.permissives]
manual_waived = "no loop"
"""


def test_what_an_io_module_cannot_hold_is_refused_with_key_value_limit_and_remedy(plant_file: Path) -> None:
    plant_file.write_text(ON_MODULE, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    takes = "ao0 of advantech_adam_6024 (device 1 on io-1) takes 20000 to 100000 Pa in steps of 19.54"
    scaling = "correct signal and quantity of the command"
    expected = (
        ("limits.pressure_pa = [0.0, 100000.0]", takes, f"keep the limits inside that, or {scaling}"),
        ("safe_value_pa = 0.0", takes, f'choose a safe value inside that or "entry", or {scaling}'),
        (
            "watchdog.timeout_s = 70.0",
            "map advantech_adam_6024 has no watchdog",
            'say watchdog.waived = "why" to go without',
        ),
        (
            'acquisition.mode = "captured"',
            "map advantech_adam_6024 has no capture buffer",
            'say mode = "polled"',
        ),
    )
    lines = [f"plant.toml: valves[0].{': '.join(one)}" for one in expected]
    assert str(caught.value).splitlines() == lines


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ("travel_m = 0.1", "travel_m = -1.0"),
        ("period_s = 0.05", ""),
        ("timeout_s = 70.0", ""),
        ('manual_waived = "no loop"', "colour = 1"),
        ("safe_value_pa = 0.0", "safe_value_pa = -1.0"),
        ('tag = "FV-201"', 'tag = "FV-201"\ncolour = 1'),
    ],
)
def test_no_part_that_is_wrong_hides_what_a_device_cannot_hold(plant_file: Path, was: str, now: str) -> None:
    assert was in ON_MODULE
    plant_file.write_text(ON_MODULE.replace(was, now), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    assert "limits.pressure_pa = [0.0, 100000.0]: ao0 of advantech_adam_6024" in str(caught.value)
    assert len(str(caught.value).splitlines()) >= 3


@pytest.mark.parametrize("quantity", ["[0.0, 100.0]", "[0.0, 0.0001]"], ids=["mm", "hm"])
def test_a_position_in_another_unit_than_the_travel_is_refused(plant_file: Path, quantity: str) -> None:
    plant_file.write_text(ON_MODULE.replace("[0.0, 0.1]", quantity), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"valves\[0\].position.quantity .* the travel is 0.1 m: write"):
        load_plant(plant_file)


MANY = """\
[service]
store = "s"
bind = "plant"
[[buses]]
name = "plc-1"
kind = "modbus_rtu"
serial_port = "/dev/ttyS9"
baud_rate = 1
timeout_s = -1.0
[[buses]]
name = "plc-2"
kind = "profibus"
[[buses]]
name = "io-1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = 5021
[[valves]]
tag = "FV-101"
safe_value_pa = 90000.0
colour = "red"
[valves.actuator]
diaphragm_area_m2 = -1.0
travel_m = 0.0
[valves.limits]
pressure_pa = [9.0, 1.0]
pressure_rate_pa_per_s = -4.0
longest_test_s = 0.0
[valves.command]
bus = "plc-9"
device_id = 1
map = "referense"
[valves.acquisition]
mode = "captured"
period_s = "fast"
[[valves]]
tag = "FV-102"
safe_value_pa = 0.0
[valves.actuator]
travel_m = 0.1
[valves.limits]
pressure_pa = [0.0, 100000.0]
pressure_rate_pa_per_s = 4000.0
longest_test_s = 300.0
[valves.command]
bus = "io-1"
device_id = 1
map = "advantech_adam_6024"
signal = [0.004, 0.02]
quantity = [20000.0, 100000.0]
[valves.acquisition]
mode = "polled"
period_s = 0.05
[valves.position]
bus = "io-1"
device_id = 1
map = "advantech_adam_6024"
signal = [0.004, 0.02]
quantity = [0.0, 0.1]
[valves.permissives]
device_number = 7
[valves.permissives.interlock]
bus = "io-7"
device_id = 1
map = "advantech_adam_6024"
register = "ai9"
bit = 3
[[valves]]
tag = "FV-103"
safe_value_pa = 20000.0
[valves.actuator]
travel_m = 0.1
[valves.limits]
pressure_pa = [20000.0, 100000.0]
pressure_rate_pa_per_s = 4000.0
longest_test_s = 300.0
[valves.command]
bus = "plc-1"
device_id = 2
map = "reference"
[valves.acquisition]
mode = "captured"
period_s = 0.001
[[groups]]
name = "all"
valves = ["FV-101", "FV-102", "FV-900"]
[[schedules]]
name = "nightly"
cron = "61 * * * *"
zone = "Europe/Atlantis"
groups = ["all"]
sequence = "waltz"
window_s = 600.0
"""


def test_every_fault_of_a_plant_is_told_once_and_none_hides_another(plant_file: Path) -> None:
    plant_file.write_text(MANY, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    lines = str(caught.value).splitlines()
    expected = (
        'service.bind = "plant"',
        "buses[0]: bus plc-1: baud_rate 1",
        "buses[0]: bus plc-1: timeout_s is -1",
        'buses[1].kind = "profibus"',
        "valves[0].colour",
        "valves[0].actuator: actuator.travel_m is 0",
        "valves[0].actuator: actuator.diaphragm_area_m2 is -1",
        "valves[0].limits: limits.pressure_rate_pa_per_s is -4",
        "valves[0].limits: limits.longest_test_s is 0",
        "valves[0].limits: limits.pressure_pa is 9 to 1 Pa",
        'valves[0].command.bus = "plc-9"',
        "valves[0].command.map: register map 'referense'",
        "valves[0].acquisition.period_s",
        "valves[1].permissives.interlock.bus",
        "valves[1].permissives.interlock.map: register map advantech_adam_6024: no register 'ai9'",
        "valves[1].permissives: ",
        "valves[1].permissives.device_number = 7",
        'groups[0].valves[2] = "FV-900"',
        'schedules[0].zone = "Europe/Atlantis"',
        'schedules[0].cron = "61 * * * *"',
        'schedules[0].sequence = "waltz"',
    )
    for one in expected:
        found = [line for line in lines if line.startswith(f"plant.toml: {one}".rstrip(": "))]
        assert found, f"{one} is not told:\n" + "\n".join(lines)
    assert len(lines) == len(set(lines)) == len(expected), "\n".join(lines)


def test_what_names_a_bus_or_a_group_that_is_wrong_is_not_wrong_itself(plant_file: Path, plant_text: str) -> None:
    text = plant_text.replace("port = 5020", "port = 0") + (
        '[[groups]]\nname = "all"\nvalves = []\n[[schedules]]\nname = "n"\ncron = "30 2 * * *"\n'
        'zone = "UTC"\ngroups = ["all"]\nsequence = "triangle"\nwindow_s = 600.0\n'
    )
    plant_file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    first, second = str(caught.value).splitlines()
    assert first.startswith("plant.toml: buses[0]: bus plc-1: port 0 is outside")
    assert second.startswith("plant.toml: groups[0].valves = []")


CLASSES = """
[classes.isolation]
dead_band_percent = 12.0
stroke_time_max = "20 s"
[classes.control]
dead_band_percent = 5.0
"""


def test_a_valves_own_limit_stands_above_its_class_and_the_class_above_the_default(
    plant_file: Path, plant_text: str
) -> None:
    first, second = plant_text.rsplit('tag = "FV-102"', 1)
    text = first.replace('tag = "FV-101"', 'tag = "FV-101"\nclass = "isolation"', 1)
    plant_file.write_text(
        f'{text}tag = "FV-102"\nclass = "isolation"{second}[valves.health]\nstroke_time_max_s = 3.0\n{CLASSES}',
        encoding="utf-8",
    )
    plant = load_plant(plant_file)
    of_class, mixed = plant.valves["FV-101"], plant.valves["FV-102"]
    assert (of_class.limits_class, of_class.health.dead_band_percent, of_class.health.stroke_time_max_s) == (
        "isolation",
        12.0,
        20.0,
    )
    assert (mixed.health.dead_band_percent, mixed.health.stroke_time_max_s) == (12.0, 3.0)
    assert mixed.health.friction_share_percent == 15.0, "neither names it"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'class = "isolation"',
            'class = "isolatoin"',
            ['valves[0].class = "isolatoin"', "isolation, control", "write isolation"],
        ),
        ('class = "isolation"', 'class = "steam"', ["choose one of them, or add [classes.steam]"]),
        ('class = "isolation"', "class = 3", ["valves[0].class = 3", "put it in quotes"]),
        (
            "dead_band_percent = 5.0",
            "dead_band_percent = 0.0",
            ["classes.control", "dead_band_percent is 0", "above 0"],
        ),
        (
            "dead_band_percent = 5.0",
            "dead_bend_percent = 5.0",
            ["classes.control.dead_bend_percent", "write dead_band_percent"],
        ),
        (CLASSES, "", ["the plant file has no classes", "add [classes.isolation]"]),
        (CLASSES, "classes = 3\n", ["classes = 3"]),
    ],
)
def test_a_class_that_is_wrong_is_refused_once_with_those_that_exist(
    plant_file: Path, plant_text: str, old: str, new: str, expected: list[str]
) -> None:
    text = CLASSES + plant_text.replace('tag = "FV-101"', 'tag = "FV-101"\nclass = "isolation"', 1)
    assert old in text
    plant_file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError) as error:
        load_plant(plant_file)
    said = str(error.value)
    assert all(words in said for words in ("plant.toml", *expected)), said
    assert len(said.splitlines()) == 1 + ("classes = 3" in new), said


@pytest.mark.parametrize("device_id", [0, 255])
def test_the_device_at_a_network_address_itself_can_be_configured(
    plant_file: Path, plant_text: str, device_id: int
) -> None:
    plant_file.write_text(plant_text.replace("device_id = 1", f"device_id = {device_id}"), encoding="utf-8")
    assert load_plant(plant_file).valves["FV-101"].wiring.command.device_id == device_id


def test_the_broadcast_address_of_a_serial_line_is_refused(plant_file: Path, plant_text: str) -> None:
    on_tcp = 'kind = "modbus_tcp"\nhost = "127.0.0.1"\nport = 5020'
    text = plant_text.replace(on_tcp, 'kind = "modbus_rtu"\nserial_port = "/dev/ttyS9"')
    assert text != plant_text
    plant_file.write_text(text.replace("device_id = 1", "device_id = 0"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"valves\[0\].command.device_id: bus plc-1: .* 1 to 247"):
        load_plant(plant_file)


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
