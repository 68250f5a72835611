"""``breakaway watch``: sentences, tables, JSON, and each bad input as one sentence on standard error and a code."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.estimators.in_service.records import AREA_M2, FRICTION_PA, TRAVEL_M, record
from tests.service.command_line import Called, called
from tests.support.plants import bus_text, service_text, valve_text
from valve.recording import Recording
from valve.recording_files import write_csv

Run = Callable[..., Called]
NAMEPLATE = f"""tag = "FV-7"
[actuator]
diaphragm_area_m2 = {AREA_M2}
travel_m = {TRAVEL_M}
bench_set_pa = [20.0e3, 100.0e3]
"""


@pytest.fixture
def run(folder: Path) -> Run:
    """Run ``breakaway watch`` with these arguments in the folder of the files."""
    return partial(called, "watch", folder=folder, columns=100)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a nameplate, good records and bad ones."""
    here = tmp_path_factory.mktemp("watch")
    good = record(1.0, 1.0)
    write_csv(good, here / "loop.csv")
    (here / "fv-7.toml").write_text(NAMEPLATE)
    pressure_pa = good.pressure_pa
    assert pressure_pa is not None
    percent = 100.0 * good.position_m / TRAVEL_M
    rows = zip(good.time_s, percent, pressure_pa / 1.0e5, (pressure_pa - 20.0e3) / 800.0, strict=True)
    lines = [f"{int(at) // 60:02d}:{int(at) % 60:02d};{x:.3f};{bar:.5f};{out:.3f}" for at, x, bar, out in rows]
    stamps = [f"2026-03-01 {6 + int(line[:2]) // 60:02d}:{line}" for line in lines]
    (here / "export.csv").write_text(
        "\n".join(["Timestamp;Valve position [%];Actuator pressure [bar];OP [%]", *stamps])
    )
    (here / "output.csv").write_text(
        "\n".join(
            ["Timestamp;Valve position [%];OP [%]", *(";".join(np.array(one.split(";"))[[0, 1, 3]]) for one in stamps)]
        )
    )
    still = Recording(good.time_s, np.full(good.samples, 0.01), pressure_pa=pressure_pa)
    write_csv(still, here / "still.csv")
    time_s = np.array(good.time_s)
    time_s[2000:] -= 600.0
    backwards = (here / "loop.csv").read_text().splitlines()
    backwards[2001:] = [
        f"{at},{line.partition(',')[2]}" for at, line in zip(time_s[2000:], backwards[2001:], strict=True)
    ]
    (here / "backwards.csv").write_text("\n".join(backwards))
    write_csv(good.rows(slice(0, 30)), here / "short.csv")
    write_changing(good, here)
    days = Recording(
        np.arange(0.0, 3.0 * 86400.0, 60.0), np.resize(good.position_m, 4320), pressure_pa=np.resize(pressure_pa, 4320)
    )
    write_csv(days, here / "days.csv")
    return here


def write_changing(good: Recording, here: Path) -> None:
    """Write records whose clock, unit or source changes in the middle."""
    assert good.pressure_pa is not None
    later = np.arange(good.samples) >= 1800
    paused_s, in_inch, in_psi = (
        good.time_s + 8.0 * 86400.0 * later,
        np.where(later, 25.4, 1.0),
        np.where(later, 1.0 / 14.50377, 1.0),
    )
    write_csv(Recording(paused_s, good.position_m, pressure_pa=good.pressure_pa), here / "paused.csv")
    write_csv(Recording(good.time_s, good.position_m / in_inch, pressure_pa=good.pressure_pa), here / "inch.csv")
    write_csv(Recording(good.time_s, good.position_m, pressure_pa=good.pressure_pa * in_psi), here / "psi.csv")
    held = np.minimum(np.arange(good.samples + 7200), 1800) + np.maximum(np.arange(good.samples + 7200) - 9000, 0)
    stopped = Recording(np.arange(float(held.size)), good.position_m[held], pressure_pa=good.pressure_pa[held])
    write_csv(stopped, here / "stopped.csv")


def test_the_answer_comes_first_in_sentences_and_then_in_a_table(run: Run) -> None:
    outcome = run("loop.csv", "--nameplate", "fv-7.toml")
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.startswith("Friction 1")
    for words in ("of span)", "Breakaway", "from breakaway", "Dead band", "Spring rate", "N/mm", "Cycles", "an hour"):
        assert words in outcome.stdout
    assert "Not known: lag of the pressure: needs both the command and the pressure" in outcome.stdout
    assert "Where the stem stood" in outcome.stdout


def test_an_export_without_a_nameplate_gives_bands_and_says_what_forces_need(run: Run) -> None:
    outcome = run("export.csv", "--map", "command_pa=")
    assert outcome.returncode == 0, outcome.stderr
    assert "kPa" in outcome.stdout
    assert "friction in motion in N" in outcome.stdout
    assert "needs the diaphragm's area" in outcome.stdout
    assert "percent, the travel is not known" in outcome.stdout


def test_a_controller_output_in_percent_gives_bands_in_percent(run: Run) -> None:
    outcome = run("output.csv", "--map", "command_pa=OP [%]", "--json", "-")
    assert outcome.returncode == 0, outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["figures"]["stick_band"]["unit"] == "%"
    assert document["figures"]["stick_band"]["value"] == pytest.approx(7000.0 / 800.0, rel=0.05)
    assert document["recording"]["driven_by"] == "command"
    assert document["recording"]["understood"][0]["columns"][0]["column"] == "time_s"
    assert "upper bounds" in outcome.stderr


def test_a_valve_of_a_plant_file_is_its_nameplate(run: Run, folder: Path) -> None:
    text = service_text() + bus_text("line", 15020) + valve_text("FV-101", "line", actuator=(AREA_M2, TRAVEL_M))
    (folder / "plant.toml").write_text(text)
    outcome = run("loop.csv", "--config", "plant.toml", "--valve", "FV-101", "--json", "plant.json")
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads((folder / "plant.json").read_text())["figures"]["friction"]["unit"] == "N"


def test_the_json_holds_every_figure_with_its_interval_or_its_reason(run: Run, folder: Path) -> None:
    assert run("loop.csv", "--nameplate", "fv-7.toml", "--json", "result.json").returncode == 0
    document = json.loads((folder / "result.json").read_text())
    friction = document["figures"]["friction"]
    low, high = friction["ci95"]
    assert low <= AREA_M2 * FRICTION_PA <= high
    for one in document["figures"].values():
        assert (one["value"] is None) == bool(one["note"])


def test_days_of_slow_rows_are_no_milliseconds(run: Run) -> None:
    outcome = run("days.csv", "--nameplate", "fv-7.toml")
    assert "milliseconds" not in outcome.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["still.csv", "--nameplate", "fv-7.toml"], 1, "still.csv: the stem made 0 moves"),
        (
            ["short.csv", "--nameplate", "fv-7.toml"],
            1,
            "30 rows have a position and a signal, watching needs at least 60",
        ),
        (["backwards.csv", "--nameplate", "fv-7.toml"], 1, "the clock goes back once, by "),
        (["paused.csv", "--nameplate", "fv-7.toml"], 1, "the clock jumps by 8 days after row 1800"),
        (["inch.csv", "--nameplate", "fv-7.toml"], 1, "the unit of the position changes after row 1800"),
        (["psi.csv", "--nameplate", "fv-7.toml"], 1, "write one unit"),
        (["loop.csv", "--map", "position_m=ZT-7"], 1, "the header 'ZT-7', the file has 'time_s', 'pressure_pa',"),
        (["missing.csv"], 1, "missing.csv: there is no such file"),
        (["loop.csv", "--nameplate", "none.toml"], 1, "there is no such nameplate file"),
        (["loop.csv", "--config", "plant.toml"], 2, "go together"),
        (["loop.csv", "--nameplate", "fv-7.toml", "--config", "plant.toml", "--valve", "X"], 2, "not both"),
        (["loop.csv", "--json", "nowhere/x.json"], 1, "there is no folder nowhere"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_a_code(run: Run, arguments: list[str], code: int, words: str) -> None:
    outcome = run(*arguments)
    assert outcome.returncode == code
    assert words in " ".join(outcome.stderr.split())
    assert "Traceback" not in outcome.stderr


def test_a_source_that_stopped_is_said_once_and_changes_no_figure(run: Run) -> None:
    whole, stopped = (run(name, "--nameplate", "fv-7.toml", "--json", "-") for name in ("loop.csv", "stopped.csv"))
    assert stopped.returncode == 0, stopped.stderr
    assert " ".join(stopped.stderr.split()).count("hold one value for 2 h, first after 1800 s") == 1
    found, true = (json.loads(one.stdout)["figures"]["friction"]["value"] for one in (stopped, whole))
    assert found == pytest.approx(true, rel=0.05)


def test_the_example_says_what_the_documentation_shows() -> None:
    root = Path(__file__).parents[2]
    outcome = called(
        "watch", "examples/in-service.csv", "--nameplate", "examples/recordings/valve.toml", folder=root, columns=100
    )
    assert outcome.returncode == 0, outcome.stderr
    shown = (root / "docs" / "watching.md").read_text(encoding="utf-8").split("```")[3]
    said = " ".join(outcome.stdout.split())
    for line in shown.strip().splitlines():
        assert " ".join(line.split()) in said, line
