"""``breakaway analyze``: tables, JSON, and that each bad input is one sentence on standard error and a code."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from service.cli import main
from tests.service.recordings import NAMEPLATE_TOML, at_rest, sine_test, triangle_test
from valve.recording_files import write_csv, write_parquet


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path) -> Run:
    """Run ``breakaway analyze`` with these arguments in the folder of the files."""
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.chdir(folder)

    def call(*arguments: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["breakaway", "analyze", *arguments])
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else (0 if end.code is None else 1)
        caught = capsys.readouterr()
        return Outcome(code, caught.out, caught.err)

    return call


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
    (here / "force.csv").write_text("time_s,force_n,position_m\n0,4,0\n1,12,0.05\n")
    lines = (here / "triangle.csv").read_text().splitlines()
    millimetres = [f"{line.rpartition(',')[0]},{1e3 * float(line.rpartition(',')[2])!r}" for line in lines[1:]]
    (here / "mm.csv").write_text("\n".join([lines[0], *millimetres]))
    return here


def test_both_methods_stand_beside_each_other_with_intervals_and_quality(run: Run) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml", "--held-out", "sine.parquet")
    assert outcome.code == 0, outcome.err
    for words in (
        "regression (",
        "garcia (",
        "95 % interval",
        "F_c [N]  Coulomb friction",
        "position noise",
        "2 ms",
        "missed slots",
        "spring rate",
        "52.53",
        "N/mm",
        "half of the loop's width",
        "Signature measured on the recording",
        "Held-out sine.parquet",
        "Diagnosis: nothing beyond the noise",
        "Health: not assessed",
    ):
        assert words in outcome.out
    assert "Traceback" not in outcome.err


def test_what_is_not_identifiable_is_said_with_its_reason(run: Run) -> None:
    outcome = run("rest.csv", "--nameplate", "fv-101.toml")
    assert outcome.code == 0, outcome.err
    assert outcome.out.count("not identifiable") == 21
    assert "regression and garcia and maximum likelihood: The stem never moved" in outcome.out
    assert "Signature (" not in outcome.out
    assert outcome.out.count("Signature: The stem never moved") == 1


def test_json_goes_to_a_file_beside_the_tables(run: Run, folder: Path) -> None:
    outcome = run("triangle.csv", "--nameplate", "fv-101.toml", "--json", "out.json")
    assert outcome.code == 0, outcome.err
    assert "Parameters" in outcome.out
    analysis = json.loads((folder / "out.json").read_text())
    assert analysis["schema"] == "breakaway/analysis/1"
    assert analysis["recording"]["samples"] == 10_001


def test_json_on_standard_output_stands_there_alone(folder: Path) -> None:
    command = [sys.executable, "-m", "service.cli", "analyze", "triangle.csv", "--nameplate", "fv-101.toml"]
    done = subprocess.run(
        [*command, "--json", "-"], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["schema"] == "breakaway/analysis/1"


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
        (["triangle.csv", "force.csv", "--nameplate", "fv-101.toml"], "analysis: recording 2 has the channels force_n"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--held-out", "empty.csv"], "empty.csv: the file is empty"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--json", "no/out.json"], "no/out.json: there is no folder no"),
        (["triangle.csv", "--nameplate", "fv-101.toml", "--json", "."], ".: it is a folder"),
    ],
)
def test_a_bad_input_is_one_sentence_and_code_1(run: Run, arguments: list[str], says: str) -> None:
    outcome = run(*arguments)
    assert outcome.code == 1
    assert outcome.out == ""
    assert says in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err


@pytest.mark.parametrize(
    "arguments",
    [[], ["triangle.csv"], ["--nameplate", "fv-101.toml"], ["triangle.csv", "--nameplate", "fv-101.toml", "--fast"]],
)
def test_wrong_usage_is_code_2_and_no_traceback(run: Run, arguments: list[str]) -> None:
    outcome = run(*arguments)
    assert outcome.code == 2
    assert "Traceback" not in outcome.err
