"""Register maps that a plant file describes: loaded, refused, and driven."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.addresses import ValveWiring
from drivers.device import connect_valve
from drivers.maps import REGISTER_MAPS
from drivers.outcome import Ended, PlayOutcome
from drivers.registers import Kind, Register, WordOrder
from drivers.sequence import play_sequence
from drivers.transport import Transport
from service.cli.simulated_plant import plant_from_settings
from service.config.plant import Plant
from service.config.settings import load_plant
from tests.support.slave import RawSlave, TcpPort
from valve.errors import ConfigurationError, DeviceError
from valve.recording import Provenance
from valve.waveform import triangle

COMMAND, SHOWN, POSITION, PRESSURE, TYPE = 100, 110, 200, 202, 300
PLANT = """\
[service]
store = "s"
[[buses]]
name = "io-1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = 5021
[[maps]]
name = "acme-vio"
source = "Acme VIO manual, table 4"
word_order = "CDAB"
write_function = 6
[[maps.registers]]
name = "output"
address = 100
kind = "i16"
unit = "kPa"
scale = 0.01
offset = 20.0
raw_range = [-2000, 10000]
writable = true
role = "command"
readback = "output_now"
[[maps.registers]]
name = "output_now"
address = 110
kind = "i16"
unit = "kPa"
scale = 0.01
offset = 20.0
[[maps.registers]]
name = "stem"
address = 200
kind = "f32"
unit = "mm"
role = "position"
[[maps.registers]]
name = "actuator"
address = 202
kind = "f32"
unit = "kPa"
role = "pressure"
[[maps.registers]]
name = "type"
address = 300
kind = "u16"
[maps.canary]
register = "type"
expected = 4711
[[valves]]
tag = "FV-301"
safe_value_pa = 10000.0
stem_read_after_s = 0.0
[valves.actuator]
diaphragm_area_m2 = 0.06
travel_m = 0.1
[valves.limits]
pressure_pa = [0.0, 100000.0]
pressure_rate_pa_per_s = 400000.0
longest_test_s = 300.0
[valves.command]
bus = "io-1"
device_id = 1
map = "acme-vio"
[valves.acquisition]
mode = "polled"
period_s = 0.02
[valves.watchdog]
waived = "the module has none"
[valves.permissives]
manual_waived = "no loop"
[valves.simulation]
parameter_set = "nominal"
"""
WATCHDOG = """
[maps.watchdog]
timeout = "timeout"
heartbeat = "heartbeat"
safe_value = "safe"
state = "state"
armed = 1
tripped = 2
[[maps.registers]]
name = "timeout"
address = 400
kind = "u16"
unit = "s"
scale = 0.001
writable = true
[[maps.registers]]
name = "heartbeat"
address = 401
kind = "u16"
writable = true
[[maps.registers]]
name = "safe"
address = 402
kind = "f32"
unit = "Pa"
writable = true
[[maps.registers]]
name = "state"
address = 404
kind = "u16"
[[valves]]"""
WATCHED = (
    PLANT.replace("write_function = 6", "")
    .replace("[[valves]]", WATCHDOG, 1)
    .replace('waived = "the module has none"', "timeout_s = 2.0")
)


class AcmeModule:
    """A module that knows function 6 alone, and whose stem follows its output at once."""

    def __init__(self, slave: RawSlave) -> None:
        self.slave, self.moves = slave, list[int]()
        self.obeys = True
        slave.holding.clear()
        slave.functions = frozenset({3, 4, 6})
        slave.set_words(1, TYPE, [4711])
        slave.set_words(1, COMMAND, [0])
        slave.set_words(1, 400, [0, 0, 0, 0, 0])
        slave.on_write = self.on_write
        self.show(0)

    def show(self, raw: int) -> None:
        self.slave.set_words(1, SHOWN, [raw])
        signed = raw - 0x10000 if raw > 0x7FFF else raw
        kilopascal = 20.0 + 0.01 * signed
        for address, value in ((POSITION, kilopascal), (PRESSURE, kilopascal)):  # a mm a kPa
            float_register = Register("x", 0, Kind.F32, word_order=WordOrder.CDAB)
            self.slave.set_words(1, address, float_register.encode(value))

    def on_write(self, _: int, address: int, words: list[int]) -> None:
        if address == COMMAND:
            self.moves.append(words[0])
            if self.obeys:
                self.show(words[0])
        elif address == 400:
            self.slave.set_words(1, 404, [1 if words[0] else 0])


@pytest.fixture
def slave() -> RawSlave:
    return RawSlave()


def loaded(folder: Path, text: str) -> Plant:
    file = folder / "plant.toml"
    file.write_text(text, encoding="utf-8")
    return load_plant(file)


async def played(wiring: ValveWiring, slave: RawSlave, plant: Plant) -> PlayOutcome:
    async with TcpPort(slave) as port:
        bus = Transport(replace(plant.buses["io-1"], port=port.port))  # type: ignore[arg-type]
        await bus.open()
        try:
            return await play_sequence(
                connect_valve(wiring, {"io-1": bus}),
                triangle(0.5, 1, 10_000.0, 60_000.0),
                mode="polled",
                period_s=0.02,
                run_number=5,
                stop=asyncio.Event(),
                on_samples=lambda _: None,
                on_progress=lambda _share, _phase: None,
                limits=wiring.limits,
                provenance=Provenance(),
            )
        finally:
            await bus.close()


def test_a_map_of_the_plant_file_is_a_register_map_in_si_units(quick_path: Path) -> None:
    plant = loaded(quick_path, PLANT)
    made = plant.valves["FV-301"].wiring.maps["acme-vio"]
    assert made.register("output").encode(10_000.0) == (0xFC18,)  # -1000 hundredths of a kPa below 20 kPa
    assert made.register("stem").word_order is WordOrder.CDAB
    assert made.register("stem").span.unit == "m"
    assert (made.write_function, made.readbacks) == (6, {"output": "output_now"})
    assert "acme-vio" not in REGISTER_MAPS, "it is this plant's and no other's"


async def test_a_device_that_knows_function_6_alone_is_tested_by_a_map_of_the_plant_file(
    quick_path: Path, slave: RawSlave
) -> None:
    module, plant = AcmeModule(slave), loaded(quick_path, PLANT)
    outcome = await played(plant.valves["FV-301"].wiring, slave, plant)
    assert (outcome.ended, outcome.error, outcome.safe_confirmed) == (Ended.COMPLETED, None, True)
    assert outcome.recording is not None
    assert outcome.recording.pressure_pa is not None
    assert np.nanmax(outcome.recording.position_m) == pytest.approx(0.06, abs=0.002)
    assert np.nanmax(outcome.recording.pressure_pa) == pytest.approx(60_000.0, abs=2_000.0)
    assert module.moves[-1] == 0xFC18, "the safe value came last"
    assert {request[1] for request in slave.requests} == {3, 6}


async def test_a_write_by_function_6_that_was_acknowledged_and_not_carried_out_ends_the_test(
    quick_path: Path, slave: RawSlave
) -> None:
    module, plant = AcmeModule(slave), loaded(quick_path, PLANT)
    module.obeys = False
    outcome = await played(plant.valves["FV-301"].wiring, slave, plant)
    assert outcome.ended is Ended.FAILED
    assert not outcome.safe_confirmed


async def test_a_device_that_refuses_function_16_is_told_with_the_key_that_helps(
    quick_path: Path, slave: RawSlave
) -> None:
    AcmeModule(slave)
    plant = loaded(quick_path, PLANT.replace("write_function = 6", ""))
    outcome = await played(plant.valves["FV-301"].wiring, slave, plant)
    assert not outcome.safe_confirmed
    assert "exception 1 to function 16" in str(outcome.error)
    assert "write_function = 6" in str(outcome.error)


async def test_the_canary_of_a_map_of_the_plant_file_keeps_another_device_still(
    quick_path: Path, slave: RawSlave
) -> None:
    module, plant = AcmeModule(slave), loaded(quick_path, PLANT)
    slave.set_words(1, TYPE, [4712])
    with pytest.raises(DeviceError, match="map acme-vio expects 4711: another device answers"):
        await played(plant.valves["FV-301"].wiring, slave, plant)
    assert module.moves == []


@pytest.mark.parametrize("obeys", [True, False])
async def test_the_watchdog_of_a_map_of_the_plant_file_is_set_and_read_back(
    quick_path: Path, slave: RawSlave, obeys: bool
) -> None:
    module, plant = AcmeModule(slave), loaded(quick_path, WATCHED)
    slave.functions = frozenset({3, 16})
    if not obeys:
        slave.on_write = lambda _unit, address, _words: 3 if address == 400 else None
    wiring = plant.valves["FV-301"].wiring
    if not obeys:
        with pytest.raises(DeviceError, match="exception 3"):
            await played(wiring, slave, plant)
        assert module.moves == []
        return
    outcome = await played(wiring, slave, plant)
    assert (outcome.ended, outcome.error, outcome.safe_confirmed) == (Ended.COMPLETED, None, True)
    safe = Register("safe", 402, Kind.F32, word_order=WordOrder.CDAB).encode(10_000.0)
    fed = [words for _, address, words in slave.writes if address == 400]
    assert fed[0][0] == 2000
    assert all(tuple(words[2:]) == safe for words in fed)
    assert fed[-1][0] == 0, "and switched off at the end"


def test_a_plant_with_a_map_of_its_own_can_be_simulated(quick_path: Path) -> None:
    assert set(plant_from_settings(loaded(quick_path, PLANT)).valves) == {"FV-301"}


def test_the_example_in_the_documents_is_a_map_that_is_taken(quick_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "plant.md").read_text(encoding="utf-8")
    example = "[[maps]]" + text.partition("```toml\n[[maps]]")[2].partition("```")[0]
    before, _, after = PLANT.partition("[[maps]]")
    plant = loaded(quick_path, f"{before}{example}[[valves]]{after.partition('[[valves]]')[2]}")
    assert set(plant.maps) == {"acme-vio"}


LIKE = """\
[[maps]]
name = "swapped"
source = "its setting Endian is Little"
like = "moxa_iologik_e1241"
word_order = "CDAB"
write_function = 6
[[maps]]
name = "acme-vio\""""


def test_a_map_of_the_drivers_is_taken_in_another_word_order_and_with_another_function(quick_path: Path) -> None:
    made = loaded(quick_path, PLANT.replace('[[maps]]\nname = "acme-vio"', LIKE)).maps["swapped"]
    before = REGISTER_MAPS["moxa_iologik_e1241"]
    assert made.register("ao0").word_order is WordOrder.CDAB
    assert replace(made.register("ao0"), word_order=WordOrder.ABCD) == before.register("ao0")
    assert made.register("ao0_raw") == before.register("ao0_raw")
    assert (made.roles, made.readbacks, made.write_function) == (before.roles, before.readbacks, 6)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('like = "moxa_iologik_e1241"', 'like = "moxa"', r'maps\[0\].like = "moxa": the drivers have no such map'),
        ('like = "moxa_iologik_e1241"', 'like = "reference"', r"maps\[0\].word_order = .*has a capture buffer"),
        ('like = "moxa_iologik_e1241"\nword_order = "CDAB"', 'like = "reference"', "command has 2 registers"),
        ("write_function = 6", "is_positioner = false", r"maps\[0\].is_positioner = false: moxa_iologik_e1241 says it"),
        ('like = "moxa_iologik_e1241"\n', "", r"maps\[0\].registers = null: it is missing: add"),
    ],
)
def test_what_cannot_be_changed_of_a_map_of_the_drivers_is_refused(
    quick_path: Path, old: str, new: str, expected: str
) -> None:
    assert old in LIKE
    with pytest.raises(ConfigurationError, match=expected):
        loaded(quick_path, PLANT.replace('[[maps]]\nname = "acme-vio"', LIKE.replace(old, new)))


BAD = {
    "a value of two registers on a device that takes one": (
        'name = "output"\naddress = 100\nkind = "i16"',
        'name = "output"\naddress = 100\nkind = "i32"',
        ["maps[0] = ", "output has 2 registers (i32)", "write_function 6", "write_function = 16"],
    ),
    "a map that nobody describes": (
        'map = "acme-vio"',
        'map = "acme"',
        ["valves[0].command.map", "unknown", "acme-vio"],
    ),
    "an unknown kind": (
        'kind = "f32"\nunit = "mm"',
        'kind = "float"\nunit = "mm"',
        ['maps[0].registers[2].kind = "float"', "f32"],
    ),
    "an unknown unit": ('unit = "mm"', 'unit = "furlong"', ["maps[0].registers[2].unit", "furlong", "mm, um"]),
    "a position in Pa": ('unit = "mm"', 'unit = "kPa"', ["maps[0].registers[2].unit", "stem is in Pa", "m, A, V, 1"]),
    "an order of one word": (
        "address = 300\n",
        'address = 300\nword_order = "CDAB"\n',
        ["maps[0].registers[4].word_order", "one register", "remove it"],
    ),
    "an order that is none": ('word_order = "CDAB"', 'word_order = "little"', ["maps[0].word_order", "little", "ABCD"]),
    "registers that overlap": ("address = 202", "address = 201", ["maps[0]", "stem and actuator overlap", "move one"]),
    "a register twice": ('name = "actuator"', 'name = "stem"', ["maps[0]", "stem stands in it twice", "rename"]),
    "an address beyond the table": ("address = 300", "address = 65536", ["maps[0].registers[4].address = 65536"]),
    "a command that cannot be written": (
        "writable = true\n",
        "",
        ["maps[0].registers[0].writable", "not writable", "say writable = true"],
    ),
    "a read-back that is not there": ('"output_now"\n[', '"output_then"\n[', ["maps[0]", "no register 'output_then'"]),
    "a read-back in another unit": (
        'readback = "output_now"',
        'readback = "stem"',
        ["maps[0].registers[0].readback", "in m", "same unit"],
    ),
    "a canary that the register cannot show": (
        "expected = 4711",
        "expected = 70000",
        ["maps[0]", "type must hold 70000"],
    ),
    "an unknown key": ('source = "', 'sorce = "x"\nsource = "', ["maps[0].sorce", "unknown", "write source"]),
    "a scale of nothing": ("scale = 0.01", "scale = 0.0", ["maps[0].registers[0]", "scale 0", "not 0"]),
    "a raw range beyond the kind": (
        "raw_range = [-2000, 10000]",
        "raw_range = [-2000, 70000]",
        ["maps[0].registers[0].raw_range = 70000", "i16 holds -32768 to 32767"],
    ),
    "limits that the device cannot take": (
        "raw_range = [-2000, 10000]",
        "raw_range = [-2000, 5000]",
        ["valves[0].limits.pressure_pa", "output of acme-vio (device 1 on io-1) takes 0 to 70000 Pa"],
    ),
    "a positioner": (
        "write_function = 6",
        "write_function = 6\nis_positioner = true",
        ["valves[0]", "acme-vio is a positioner"],
    ),
    "a function that writes nothing": ("write_function = 6", "write_function = 5", ["maps[0].write_function = 5"]),
}


@pytest.mark.parametrize(("old", "new", "expected"), BAD.values(), ids=list(BAD))
def test_a_wrong_map_is_refused_with_file_key_value_and_remedy(
    quick_path: Path, old: str, new: str, expected: list[str]
) -> None:
    assert old in PLANT
    with pytest.raises(ConfigurationError) as caught:
        loaded(quick_path, PLANT.replace(old, new, 1))
    assert str(caught.value).startswith("plant.toml: ")
    for part in expected:
        assert part in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1, "one fault is told once"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('writable = true\n[[maps.registers]]\nname = "state"', '[[maps.registers]]\nname = "state"', "not writable"),
        ("address = 401", "address = 411", "are written together"),
        ('unit = "s"', 'unit = "1"', "it must be in s"),
        ('source = "', 'write_function = 6\nsource = "', "its watchdog is written as a whole"),
        ('state = "state"', 'state = "none"', "no register 'none'"),
    ],
)
def test_a_watchdog_that_could_not_be_armed_is_refused(quick_path: Path, old: str, new: str, expected: str) -> None:
    assert old in WATCHED
    with pytest.raises(ConfigurationError, match=expected):
        loaded(quick_path, WATCHED.replace(old, new, 1))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (PLANT.replace("acme-vio", "moxa_iologik_e1241"), r"maps\[0\].name = .*a device of the drivers has this name"),
        (
            PLANT.replace(
                "[[valves]]",
                '[[maps]]\nname = "acme-vio"\nsource = "s"\n[[maps.registers]]\nname = "a"\n'
                'address = 1\nkind = "u16"\n[[valves]]',
            ),
            r"maps\[1\].name = .*another map has this name",
        ),
    ],
)
def test_a_name_means_one_map(quick_path: Path, text: str, expected: str) -> None:
    with pytest.raises(ConfigurationError, match=expected):
        loaded(quick_path, text)
