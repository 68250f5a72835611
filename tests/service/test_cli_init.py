"""``breakaway init``: a plant file from questions or options, right from the first time, and never another's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli import app
from service.config.settings import load_plant
from tests.service.command_line import called
from valve.errors import ConfigurationError

OPTIONS = {
    "tag": "FV-301",
    "host": "10.0.0.5",
    "travel": "4 in",
    "diaphragm-area": "100 in2",
    "signal-range": "3 to 15 psi",
    "safe-value": "3 psi",
}


def options(**other: str | None) -> list[str]:
    chosen = OPTIONS | {name.replace("_", "-"): value for name, value in other.items()}
    return [part for name, value in chosen.items() if value is not None for part in (f"--{name}", value)]


def asked(path: Path, *more: str, answers: str = "") -> tuple[str, BaseException | None]:
    """Run the command in this process; what it wrote, and how it ended."""
    found = CliRunner().invoke(app, ["init", "--config", str(path), *more], input=answers)
    return found.output, found.exception


def test_options_alone_write_a_file_that_passes_the_check(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    answer = called("init", "--config", str(path), *options())
    assert (answer.returncode, answer.stderr) == (0, "")
    assert called("check", "--config", str(path)).returncode == 0
    valve = load_plant(path).valves["FV-301"]
    assert (valve.nameplate.actuator.travel_m, valve.nameplate.actuator.diaphragm_area_m2) == (0.1016, 0.064516)
    assert valve.wiring.safe_value_pa == pytest.approx(20684.27, abs=0.01)
    assert valve.wiring.limits.pressure_rate_pa_per_s == pytest.approx(41368.54, abs=0.01)  # half of the span a second
    assert 'travel = "4 in"' in path.read_text(encoding="utf-8")


def test_a_class_of_limits_is_named_and_made(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    _, fault = asked(path, *options(), "--class", "isolation")
    assert fault is None
    assert "[classes.isolation]" in path.read_text(encoding="utf-8")
    assert load_plant(path).valves["FV-301"].limits_class == "isolation"


def test_questions_write_the_same_file_as_options(tmp_path: Path) -> None:
    by_options, by_questions = tmp_path / "a.toml", tmp_path / "b.toml"
    _, fault = asked(by_options, *options(description="Feed", bench_set="3 to 15 psi"))
    assert fault is None
    lines = ["FV-301", "Feed", "", "", "", "", "10.0.0.5", "", "", "4 kg", "4 in", "100 in2", "", "3 to 15 psi"]
    lines += ["4 to 20 mA", "3 to 15 psi", "3", "3 psi", "", ""]
    told, fault = asked(by_questions, answers="".join(f"{line}\n" for line in lines))
    assert fault is None, told
    assert by_questions.read_text().partition("\n\n")[2] == by_options.read_text().partition("\n\n")[2]
    assert "4 kg: kg is no length" in told
    assert "4 to 20 mA: mA is no pressure" in told
    assert "3: a number alone, its unit is unknown" in told


def test_a_module_with_terminals_is_wired_by_its_currents(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    more = {"map": "advantech_adam_6024", "watchdog_waived": "a relief valve protects the line"}
    _, fault = asked(path, *options(**more))
    assert fault is None
    wiring = load_plant(path).valves["FV-301"].wiring
    assert wiring.command.signal == (0.004, 0.020)
    assert wiring.position is not None
    assert wiring.position.quantity == (0.0, 0.1016)
    assert wiring.permissives.permit
    assert wiring.watchdog.waived == "a relief valve protects the line"
    other = tmp_path / "other.toml"
    _, fault = asked(other, *options(**more, manual_waived="opened at its terminals"))
    assert fault is None
    assert not load_plant(other).valves["FV-301"].wiring.permissives.permit


def test_a_serial_line_is_described_too(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    more = {"host": None, "bus": "rtu", "serial_port": "/dev/ttyUSB0", "baud_rate": "9600", "parity": "N"}
    _, fault = asked(path, *options(**more))
    assert fault is None
    assert 'serial_port = "/dev/ttyUSB0"' in path.read_text(encoding="utf-8")
    assert called("check", "--config", str(path)).returncode == 0


def test_a_file_that_is_there_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text("mine", encoding="utf-8")
    answer = called("init", "--config", str(path), *options())
    assert (answer.returncode, path.read_text(encoding="utf-8")) == (1, "mine")
    assert "it is there already" in answer.stderr


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"travel": "4 kg"}, "--travel = 4 kg: kg is no length: write it with a unit such as in"),
        ({"map": "moxa"}, "--map = moxa: choose one of reference"),
        ({"port": "x"}, "--port = x: give a whole number"),
        ({"serial_port": "/dev/x"}, "--serial-port: with the other answers it has no meaning"),
        ({"safe_value": "40 psi"}, "limits.pressure .*was not written: answer otherwise"),
        ({"travel": None}, "no answer for --description: nothing was written"),
    ],
)
def test_an_answer_that_cannot_be_writes_nothing(tmp_path: Path, more: dict[str, str | None], says: str) -> None:
    path = tmp_path / "plant.toml"
    _, fault = asked(path, *options(**more))
    assert isinstance(fault, ConfigurationError)
    assert re.search(f"(?s){says}", str(fault)), str(fault)
    assert not path.exists()
