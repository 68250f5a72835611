"""``breakaway analyze``: tables, JSON, and that each bad input is one sentence on standard error and a code."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.service.command_line import Called, called
from tests.support.nominal_recordings import NAMEPLATE_TOML, at_rest, sine_test, triangle_test
from tests.support.plants import bus_text, service_text, valve_text
from valve.recording_files import write_csv, write_parquet

Run = Callable[..., Called]


@pytest.fixture
def run(folder: Path) -> Run:
    """Run ``breakaway analyze`` with these arguments in the folder of the files."""
    return partial(called, "analyze", folder=folder, columns=160)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a nameplate, good recordings and bad ones."""
    here = tmp_path_factory.mktemp("analyze")
    write_csv(triangle_test(0.002, noise_m=2.0e-6), here / "triangle.csv")
    write_parquet(sine_test(), here / "sine.parquet")
    write_csv(at_rest(), here / "rest.csv")
    (here / "fv-101.toml").write_text(NAMEPLATE_TOML)
    (here / "mm.toml").write_text(NAMEPLATE_TOML.replace("travel_m", "travel_mm"))
    (here / "plain.toml").write_text(NAMEPLATE_TOML.partition("[signal]")[0])
    (here / "empty.csv").write_text("")
    (here / "header.csv").write_text("time_s,pressure_pa,position_m\n")
    (here / "backwards.csv").write_text("time_s,pressure_pa,position_m\n0,0,0\n2,1,0\n1,2,0\n")
    (here / "comma.csv").write_text("time_s,pressure_pa,position_m\n0,0,0\n0,1,5,2,0\n")
    (here / "current.csv").write_text("time_s,command_ma,position_m\n0,4,0\n1,12,0.05\n")
    rows = "".join(f"{second},{second},0.05\n" for second in range(30))
    (here / "force.csv").write_text("time_s,force_n,position_m\n" + rows)
    (here / "four.csv").write_text("\n".join((here / "triangle.csv").read_text().splitlines()[:5]))
    lines = (here / "triangle.csv").read_text().splitlines()
    millimetres = [f"{line.rpartition(',')[0]},{1e3 * float(line.rpartition(',')[2])!r}" for line in lines[1:]]
    (here / "mm.csv").write_text("\n".join([lines[0], *millimetres]))
    return here


def test_both_methods_stand_beside_each_other_with_intervals_and_quality(run: Run) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml", "--held-out", "sine.parquet", "--details")
    assert outcome.returncode == 0, outcome.stderr
    for words in (
        "regression (",
        "garcia (",
        "95 % interval",
        "F_c [N]  Coulomb friction",
        "position noise",
        "2 ms",
        "missed slots",
        "spring rate",
        "52.5",
        "N/mm",
        "half of the loop's width",
        "Signature measured on the recording",
        "Held-out sine.parquet",
        "Diagnosis: no fault found",
        "Health: not assessed",
    ):
        assert words in outcome.stdout
    assert "Traceback" not in outcome.stderr


def test_the_verdict_comes_first_then_five_lines(run: Run) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml")
    assert outcome.returncode == 0, outcome.stderr
    lines = [line.rstrip() for line in outcome.stdout.splitlines()]
    assert lines[0] == "No fault found. Friction is alike all along the travel."
    assert [line.split("  ")[0] for line in lines[1:6]] == [
        "Friction", "Breakaway", "Spring rate", "Dead band", "Recording",
    ]  # fmt: skip
    assert " 1423 N; 26.9 % of the actuator's force" in lines[1], "no digit that no instrument knows"
    assert lines[6:] == ["--details shows every method, the signature and the diagnosis."]


def test_what_was_understood_of_a_file_of_ones_own_stands_before_the_verdict(run: Run, folder: Path) -> None:
    rows = [line.split(",") for line in (folder / "triangle.csv").read_text().splitlines()[1:]]
    own = [
        ";".join(
            f"{float(cell) * factor:.10g}".replace(".", ",") for cell, factor in zip(row, (1e3, 1e-5, 1e3), strict=True)
        )
        for row in rows
    ]
    (folder / "own.csv").write_text("\n".join(["Zeit [ms];Druck [bar];Hub", *own]), encoding="latin-1")
    asked = run("own.csv", "--nameplate", "fv-101.toml")
    assert asked.returncode == 1
    assert '--map "position_m=Hub [%]"' in asked.stderr
    outcome = run("own.csv", "--nameplate", "fv-101.toml", "--map", "position_m=Hub [mm]", "--json", "own.json")
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.index("Zeit [ms]") < outcome.stdout.index("No fault found.")
    analysis = json.loads((folder / "own.json").read_text())
    assert [one["header"] for one in analysis["recording"]["understood"][0]["columns"]] == [
        "Zeit [ms]", "Druck [bar]", "Hub",
    ]  # fmt: skip
    likelihood = analysis["estimates"][-1]
    assert likelihood["parameters"]["F_c"]["value"] == pytest.approx(1423.4, abs=0.5)


def test_the_nameplate_may_come_from_a_plant_file(run: Run, folder: Path) -> None:
    plant = service_text() + bus_text("plc-1", 5020) + valve_text("FV-101", "plc-1")
    (folder / "plant.toml").write_text(plant)
    outcome = run("triangle.csv", "--config", "plant.toml", "--valve", "FV-101")
    assert outcome.returncode == 0, outcome.stderr
    assert "No fault found." in outcome.stdout
    unknown = run("triangle.csv", "--config", "plant.toml", "--valve", "FV-109")
    assert unknown.returncode == 1
    assert "there is no valve FV-109, there are FV-101" in unknown.stderr


def test_what_is_not_identifiable_is_said_with_its_reason(run: Run) -> None:
    outcome = run("rest.csv", "--nameplate", "fv-101.toml", "--details")
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.count("not identifiable") == 21
    assert "regression and garcia and maximum likelihood: The stem never moved" in outcome.stdout
    assert "Signature (" not in outcome.stdout
    assert outcome.stdout.count("Signature: The stem never moved") == 1


def test_json_goes_to_a_file_beside_the_tables(run: Run, folder: Path) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml", "--json", "out.json", "--details")
    assert outcome.returncode == 0, outcome.stderr
    assert "Parameters" in outcome.stdout
    analysis = json.loads((folder / "out.json").read_text())
    assert analysis["schema"] == "breakaway/analysis/1"
    assert analysis["recording"]["samples"] == 10_001


def test_json_on_standard_output_stands_there_alone(run: Run, capfd: pytest.CaptureFixture[str]) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml", "--json", "-")
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)["schema"] == "breakaway/analysis/1"
    assert capfd.readouterr().out == "", "nothing that is compiled writes there either"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none.csv", "--nameplate", "fv-101.toml"], "none.csv: there is no such file"),
        (["empty.csv", "--nameplate", "fv-101.toml"], "empty.csv: the file is empty"),
        (["header.csv", "--nameplate", "fv-101.toml"], "header.csv: it has a header and no row"),
        (
            ["backwards.csv", "--nameplate", "fv-101.toml"],
            "backwards.csv: row 3, column time_s: time goes from 2.0",
        ),
        (["comma.csv", "--nameplate", "fv-101.toml"], "comma.csv: row 2 (line 3 of the file) has 5 cells"),
        (["mm.csv", "--nameplate", "fv-101.toml"], "mm.csv: position_m reaches 74"),
        (["current.csv", "--nameplate", "plain.toml"], "current.csv: the command is in mA and the nameplate of FV-101"),
        (["fv-101.toml", "--nameplate", "fv-101.toml"], "fv-101.toml: unknown column"),
        ([".", "--nameplate", "fv-101.toml"], ".: it is a folder"),
        (["triangle.csv", "--nameplate", "none.toml"], "none.toml: there is no such nameplate file"),
        (["triangle.csv", "--nameplate", "mm.toml"], "mm.toml: unknown key actuator.travel_mm"),
        (["triangle.csv", "--nameplate", "triangle.csv"], "triangle.csv: it has "),
        (["four.csv", "--nameplate", "fv-101.toml"], "four.csv: it has 4 rows, an analysis needs at least 20"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--map", "hub=x"], "map 'hub=x': give it as"),
        (["triangle.csv", "force.csv", "--nameplate", "fv-101.toml"], "analysis: recording 2 has the channels force_n"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--held-out", "empty.csv"], "empty.csv: the file is empty"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--json", "no/out.json"], "no/out.json: there is no folder no"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--json", "."], ".: it is a folder"),
    ],
)
def test_a_bad_input_is_one_sentence_and_code_1(run: Run, arguments: list[str], says: str) -> None:
    outcome = run(*arguments)
    assert outcome.returncode == 1
    assert outcome.stdout == ""
    assert says in outcome.stderr
    assert len(outcome.stderr.strip().splitlines()) == 1, outcome.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["triangle.csv"],
        ["--nameplate", "fv-101.toml"],
        ["triangle.csv", "--nameplate", "fv-101.toml", "--fast"],
        ["triangle.csv", "--config", "plant.toml"],
        ["triangle.csv", "--nameplate", "fv-101.toml", "--config", "p.toml"],
    ],
)
def test_wrong_usage_is_code_2_and_no_traceback(run: Run, arguments: list[str]) -> None:
    outcome = run(*arguments)
    assert outcome.returncode == 2
    assert "Traceback" not in outcome.stderr


_LOADED = """
import json, sys
from tests.service.command_line import called
for arguments in json.loads(sys.argv[1]):
    outcome = called("analyze", "triangle.csv", *arguments)
    assert outcome.returncode == 0, outcome.stderr
    print(sorted({name.partition(".")[0] for name in sys.modules} & set(json.loads(sys.argv[2]))))
"""


def test_neither_web_nor_database_nor_wire_is_loaded(folder: Path) -> None:
    (folder / "loaded.toml").write_text(service_text() + bus_text("plc-1", 5020) + valve_text("FV-101", "plc-1"))
    plain = ["--nameplate", "fv-101.toml"]
    forms = [plain, [*plain, "--report", "loaded.html"], ["--config", "loaded.toml", "--valve", "FV-101"]]
    heavy = ["fastapi", "starlette", "uvicorn", "sqlalchemy", "alembic", "pymodbus", "serial"]
    asked = [sys.executable, "-c", _LOADED, json.dumps(forms), json.dumps(heavy)]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["[]", "[]", "[]"]
