from __future__ import annotations

import asyncio
import json
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from service.cli.simulate import _serve, simulate
from service.cli.simulated_plant import plant_from_settings
from service.cli.truths import read_truths, record_truth, write_truth
from service.config.settings import load_plant
from simulator.gauge import Gauge
from simulator.plant import SoftwareValve
from simulator.samples import EndedRecord
from tests.support.simulated_plants import valve as simulated_valve
from valve.errors import ConfigurationError
from valve.packing import PACKINGS

PLANT = """
[service]
store = "store"
[[buses]]
name = "plc"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {port}
[[buses]]
name = "line"
kind = "modbus_rtu"
serial_port = "{folder}/line"
[[buses]]
name = "gauge"
kind = "serial_gauge"
serial_port = "{folder}/gauge"
request = "?"
pattern = '(?P<value>-?[0-9.]+) mm'
"""
VALVE = """
[[valves]]
tag = "{tag}"
safe_value_pa = 0.0
actuator = {{ diaphragm_area_m2 = 0.06452, travel_m = 0.1016 }}
signal = {{ range_ma = [4.0, 20.0], range_pa = [0.0, 82737.0] }}
limits = {{ pressure_pa = [0.0, 82737.0], pressure_rate_pa_per_s = 30000.0, longest_test_s = 300.0 }}
acquisition = {{ mode = "polled", period_s = 0.01 }}
command = {{ bus = "{bus}", device_id = {device}, map = "reference" }}
{more}
"""


def hiding(*effects: str, more: str = "adc_bits = 16") -> str:
    listed = ", ".join(f"{{ {entry} }}" for entry in effects)
    return f'simulation = {{ parameter_set = "nominal", {more}, effects = [{listed}] }}'


NOMINAL = 'simulation = { parameter_set = "nominal", position_noise_m = 1.0e-6 }'


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def write(folder: Path, *valves: str) -> Path:
    path = folder / "plant.toml"
    path.write_text(PLANT.format(port=free_port(), folder=folder) + "".join(valves))
    return path


def valve(tag: str, device: int = 1, bus: str = "plc", more: str = NOMINAL) -> str:
    return VALVE.format(tag=tag, device=device, bus=bus, more=more)


def test_a_plant_is_built_as_its_file_says(tmp_path: Path) -> None:
    symbols = "{ m = 2.0, k = 5.0e4, F_v = 600.0, F_c = 700.0, F_s = 900.0, DV = 1.0e-4 }"
    more = f'position = {{ bus = "gauge" }}\nsimulation = {{ parameters = {symbols}, lag_s = 0.3, adc_bits = 12, '
    path = write(
        tmp_path,
        valve("A"),
        valve("B", 2, more=more + "travel_stops_m = [0.0, 0.1], seed = 4 }"),
        valve("C", 1, "line"),
    )
    plant = plant_from_settings(load_plant(path), 5.0)
    assert plant.descriptions == [
        "unit 1 (reference) A; unit 2 (reference) B",
        "unit 1 (reference) C",
        "gauge of B",
    ]
    settings = plant.valves["B"].settings
    assert settings.parameters.mass_kg == 2.0
    assert settings.transducer.lag_s == 0.3
    assert settings.position.adc_bits == 12
    assert settings.stops.high_m == 0.1
    assert plant.valves["A"].settings.position.seed != plant.valves["C"].settings.position.seed
    assert isinstance(plant.gauges[0], Gauge)


def test_a_valve_hides_the_effects_that_its_file_lists(tmp_path: Path) -> None:
    spot = 'cause = "local_friction", rise_n = 150.0, centre_m = 0.06, width_m = 0.002'
    more = hiding(spot, 'cause = "position_backlash", strength = 2.0', 'cause = "actuator_leak", strength = 1')
    extended = plant_from_settings(load_plant(write(tmp_path, valve("A", more=more)))).valves["A"].settings.extended
    assert extended.friction.spot_n == 150.0
    assert extended.friction.spot_width_m == 0.002
    assert extended.sensor.play_m == pytest.approx(2.0 * 0.005 * 0.1016)
    assert extended.input.leak == pytest.approx(0.03)


def packed(more: str) -> str:
    return f'simulation = {{ parameter_set = "nominal", seed = 5, {more} }}'


def test_a_packing_preset_makes_the_instruments_alike_and_single_values_replace_it(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        valve("A", more=packed('packing = { preset = "usual", wander = 0.01 }')),
        valve(
            "B",
            2,
            more=packed(
                'packing = { roughness = 0.02, roughness_law = "smooth" }, position_noise_m = 3.0e-6, '
                'position_sensor = { preset = "hard", hum_m = 4.0e-6, refresh_s = 0.05, dropout_to = "gap" }, '
                "pressure_sensor = { noise_pa = 20.0, filter_s = 0.01 }, hunting = { swing_pa = 90.0, period_s = 2.0 }"
            ),
        ),
        valve("C", 3),
    )
    built = plant_from_settings(load_plant(path)).valves
    a, b, c = (built[tag].settings for tag in "ABC")
    assert (a.packing.breakaway_scatter, a.packing.roughness, a.packing.wander) == (0.025, 0.015, 0.01)
    assert (a.position.adc_bits, a.position.filter_s) == (14, 0.005)
    assert a.position.noise_rms == pytest.approx(1.0e-4 * 0.1016)
    assert a.pressure is not None
    assert a.pressure.coloured_rms == pytest.approx(1.0e-3 * 82737.0)
    assert a.pressure.filter_s == 0.008
    assert a.transducer.hunting.swing_pa == pytest.approx(82.737)
    assert a.packing_seed == 5
    assert (b.packing.breakaway_scatter, b.packing.roughness, b.packing.roughness_law) == (0.0, 0.02, "smooth")
    assert (b.position.noise_rms, b.position.hum_rms, b.position.refresh_s) == (3.0e-6, 4.0e-6, 0.05)
    assert (b.position.adc_bits, b.position.dropout_to) == (12, "gap")
    assert b.pressure is not None
    assert (b.pressure.noise_rms, b.pressure.filter_s, b.pressure.adc_bits) == (20.0, 0.01, 16)
    assert (b.transducer.hunting.swing_pa, b.transducer.hunting.period_s) == (90.0, 2.0)
    assert c.packing.is_ideal
    assert not c.is_packed
    assert (c.position.noise_rms, c.position.adc_bits) == (1.0e-6, 16)


def test_the_truth_of_a_record_is_a_line_of_json_that_can_be_read_back(tmp_path: Path) -> None:
    ended: list[EndedRecord] = []
    software = SoftwareValve(replace(simulated_valve("FV: 1"), packing=PACKINGS["usual"]))
    software.on_record = lambda _tag, record: ended.append(record)
    software.ask(50_000.0)
    software.look(10.0)
    path = tmp_path / "truths.jsonl"
    assert read_truths(path) == []
    told = record_truth("FV: 1", ended[0])
    with path.open("w", encoding="utf-8") as file:
        write_truth(file, told)
        file.write('{"tag": "FV')
    assert read_truths(path) == [told]
    assert told.tag == "FV: 1"
    assert told.duration_s == pytest.approx(1.0)
    assert told.parameters == ended[0].truth.parameters.by_symbol()
    assert told.scatter["F_s"] == ended[0].truth.static_scatter_n
    assert told.in_words().startswith("FV: 1: truth of the record from 0.0 to ")


async def test_the_command_tells_the_truth_of_each_test_that_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = plant_from_settings(
        load_plant(write(tmp_path, valve("A", more=packed('packing = { preset = "hard" }')))), 20.0
    )
    truths = tmp_path / "truths.jsonl"
    serving = asyncio.create_task(_serve(plant, None, truths))
    deadline, said = time.monotonic() + 30.0, ""
    while "reference" not in said and time.monotonic() < deadline:
        await asyncio.sleep(0.02)
        said += capsys.readouterr().out
    plant.valves["A"].ask(60_000.0)
    while "truth" not in said and time.monotonic() < deadline:
        await asyncio.sleep(0.05)
        said += capsys.readouterr().out
    serving.cancel()
    with pytest.raises(asyncio.CancelledError):
        await serving
    told = read_truths(truths)
    assert [truth.tag for truth in told] == ["A"]
    assert told[0].parameters["F_c"] == pytest.approx(1423.4, rel=0.15)
    assert told[0].parameters["F_c"] != 1423.4
    assert told[0].scatter["F_s"] > 50.0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("", "cannot be simulated"),
        (packed('packing = { preset = "normal" }'), r"packing\.preset"),
        (packed("packing = { roughnes = 0.1 }"), r"packing\.roughnes.*write roughness"),
        (packed("packing = { roughness = 2.0 }"), "roughness is 2"),
        (packed('packing = "usual"'), "no table"),
        (packed("position_sensor = { noise_pa = 2.0 }"), r"position_sensor\.noise_pa"),
        (packed("pressure_sensor = { filter_s = -1.0 }"), "filter_s is -1"),
        (packed("hunting = { swing_pa = -1.0 }"), "hunts by -1"),
        ("simulation = { }", "twice or not at all"),
        ('simulation = { parameter_set = "nominal", noise = 1.0 }', "noise"),
        ('simulation = { parameter_set = "nominal", lag_s = -1.0 }', "lag_s"),
        ('simulation = { parameter_set = "nominl" }', "nominl"),
        ('simulation = { parameter_set = "nominal", travel_stops_m = [1.0, 0.0] }', "stops"),
        ("simulation = { parameters = { m = 1.0, K = 2.0 } }", "K"),
        (hiding('cause = "local_frction"'), r"effects\[0\]\.cause.*write local_friction"),
        (hiding("strength = 1.0"), "cause is missing"),
        (hiding('cause = "bent"'), "choose one of friction_asymmetry, stribeck_friction"),
        (hiding('cause = "local_friction", rise_n = 9.0, width_m = 0.01'), "centre_m: missing"),
        (hiding('cause = "local_friction", strength = 1.0, rise_n = 9.0'), "rise_n and strength are both given"),
        (hiding('cause = "local_friction", strength = 1.0, width = 0.1'), "width: no such parameter"),
        (hiding('cause = "position_lag", lag_s = "0.1"'), r"effects\[0\]\.lag_s.*without quotes"),
        (hiding('cause = "position_lag", lag_s = -0.1'), r"effects\[0\].*lag_s is -0\.1"),
        (hiding('cause = "position_lag", lag_s = 0.1', 'cause = "position_lag", lag_s = 0.2'), "0.1 already"),
        (hiding('cause = "transducer_lag", lag_s = 0.1', more="lag_s = 0.9"), "leave one out"),
    ],
)
def test_a_simulation_that_cannot_be_is_refused_in_words(tmp_path: Path, more: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        plant_from_settings(load_plant(write(tmp_path, valve("A", more=more))))


async def test_an_idle_valve_goes_on_without_a_log_so_that_the_first_read_need_not_wait_for_its_past(
    tmp_path: Path,
) -> None:
    plant = plant_from_settings(
        load_plant(write(tmp_path, valve("A", more=hiding('cause = "presliding", strength = 1.0'))))
    )
    looked = asyncio.Event()
    plant.valves["A"].before_advance = lambda _to_s: looked.set()
    serving = asyncio.create_task(_serve(plant, None))
    await asyncio.wait_for(looked.wait(), 20.0)
    serving.cancel()
    with pytest.raises(asyncio.CancelledError):
        await serving


@pytest.fixture
def command(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path, Path]]:
    path, log = write(tmp_path, valve("A"), valve("C", 1, "line")), tmp_path / "log"
    path.write_text(path.read_text().replace("polled", "captured"))
    arguments = ["simulate", "--config", str(path), "--speed", "10", "--log", str(log)]
    with subprocess.Popen(
        [sys.executable, "-m", "service.cli", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        yield process, tmp_path, log
        process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_command_serves_says_so_logs_and_ends_cleanly_on_a_signal(
    command: tuple[subprocess.Popen[str], Path, Path], number: signal.Signals
) -> None:
    process, folder, log = command
    assert process.stdout is not None
    address, served = process.stdout.readline().strip().split(": ", 1)
    assert served == "unit 1 (reference) A"
    assert process.stdout.readline().strip() == f"{folder}/line: unit 1 (reference) C"
    host, port = address.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=5.0) as connection:
        for pdu in (struct.pack(">BHHBIH", 16, 36, 3, 6, 9, 1), struct.pack(">BHHBIf", 16, 32, 4, 8, 9, 5.0e4)):
            connection.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
            assert connection.recv(64)[7] == 16
    deadline = time.monotonic() + 60.0
    lines: list[dict[str, object]] = []
    while time.monotonic() < deadline and not any(line.get("position_m", 0.0) != 0.0 for line in lines):
        time.sleep(0.05)
        lines = [json.loads(line) for line in log.read_text().splitlines()]
    commanded = [line for line in lines if line.get("happening") == "commanded"]
    assert [(line["tag"], line["run"], line["pressure_pa"]) for line in commanded] == [("A", 9, 5.0e4)]
    assert any(line.get("position_m", 0.0) != 0.0 for line in lines)
    process.send_signal(number)
    assert process.wait(120.0) == 0
    assert process.stderr is not None
    assert process.stderr.read() == ""
    assert not (folder / "line").is_symlink()


def test_a_taken_port_ends_the_command_with_one_sentence(tmp_path: Path) -> None:
    path = write(tmp_path, valve("A"))
    port = int(path.read_text().split("port = ")[1].split()[0])
    with socket.create_server(("127.0.0.1", port)):
        done = subprocess.run(
            [sys.executable, "-m", "service.cli", "simulate", "--config", str(path)],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 1
    assert "cannot listen" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_polled_valve_on_a_faster_clock_is_refused_because_it_would_be_another_valve(tmp_path: Path) -> None:
    path = write(tmp_path, valve("A"))
    with pytest.raises(ConfigurationError, match=r"--speed is 10 and A have acquisition.mode = polled"):
        simulate(path, speed=10.0)
