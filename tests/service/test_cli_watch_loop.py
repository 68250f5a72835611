"""``breakaway watch`` of a loop without a stem position: the example, JSON, what headers say, and bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.service.command_line import Called, called
from tests.support.control_loops import write_example

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "loop.csv"
Run = Callable[..., Called]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the example under other headers, and with bad ones."""
    here = tmp_path_factory.mktemp("loops")
    header, *rows = EXAMPLE.read_text(encoding="utf-8").splitlines()
    columns = [row.split(";") for row in rows]

    def write(name: str, *lines: str) -> None:
        (here / name).write_text("\n".join(lines), encoding="utf-8")

    write("tags.csv", "t,LC74_20CV,LC74_20PV", *(f"{5 * n},{one[1]},{one[2]}" for n, one in enumerate(columns)))
    write("manual.csv", header, *(f"{one[0]};47.50;{one[2]};{one[3]}" for one in columns))
    write("short.csv", header, *rows[:40])
    write("word.csv", header, *rows[:200], f"{columns[200][0]};open;20.1;20.0", *rows[201:])
    write("empty.csv", "Timestamp;A.OP [%];A.PV")
    write("two.csv", "Timestamp;A.OP [%];B.OP [%];A.PV", *rows)
    write("stem.csv", "Timestamp;A.OP [%];A.PV;Valve position [%]", *rows)
    return here


@pytest.fixture
def run(folder: Path) -> Run:
    """Run ``breakaway watch`` with these arguments in the folder of the files."""
    return partial(called, "watch", folder=folder, columns=100)


def test_the_example_says_what_the_documentation_shows() -> None:
    outcome = called("watch", "examples/loop.csv", folder=ROOT, columns=100)
    assert outcome.returncode == 0, outcome.stderr
    shown = (ROOT / "docs" / "watching.md").read_text(encoding="utf-8").partition("examples/loop.csv\n```")[2]
    said = " ".join(outcome.stdout.split())
    lines = shown.split("```")[1].strip().splitlines()
    assert len(lines) > 4
    for line in lines:
        assert " ".join(line.split()) in said, line


def test_the_example_is_what_its_command_writes(tmp_path: Path) -> None:
    write_example(tmp_path / "loop.csv")
    written = (tmp_path / "loop.csv").read_text(encoding="utf-8").splitlines()
    # the last digit of a simulated hour may differ from one processor to the next
    assert len(written) == len(EXAMPLE.read_text(encoding="utf-8").splitlines())
    assert written[:20] == EXAMPLE.read_text(encoding="utf-8").splitlines()[:20]


def test_the_json_is_the_verdict_with_units_and_columns() -> None:
    outcome = called("watch", "examples/loop.csv", "--json", "-", folder=ROOT, columns=100)
    assert outcome.returncode == 0, outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["answer"] == "test_valve"
    assert document["process"] == "self-regulating"
    assert document["recording"]["output_unit"] == "%"
    assert document["recording"]["value_unit"] == "m3/h"
    assert [one["column"] for one in document["recording"]["understood"][0]["columns"]] == [
        "time_s",
        "controller_output",
        "process_value",
        "set_point",
    ]
    assert "test this valve" in " ".join(outcome.stderr.split())


def test_a_mapping_says_what_headers_leave_open(run: Run) -> None:
    mapping = "time_s=t [s],controller_output=LC74_20CV [%],process_value=LC74_20PV [mm]"
    outcome = run("tags.csv", "--map", mapping, "--json", "-")
    assert outcome.returncode == 0, outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["answer"] == "test_valve"
    assert document["recording"]["value_unit"] == "mm"
    assert not document["recording"]["has_set_point"]


def test_a_controller_in_manual_cannot_be_told_and_is_no_failure(run: Run) -> None:
    outcome = run("manual.csv")
    assert outcome.returncode == 0, outcome.stderr
    said = " ".join(outcome.stdout.split())
    assert "manual.csv: cannot tell whether the valve sticks." in said
    assert "is 47.5 in all 1440 rows" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["short.csv"], "short.csv: 40 rows have a controller output and a process value, 96 are needed"),
        (["word.csv"], "word.csv: row 201 (line 202 of the file), column 'FIC-107.OP [%]': 'open' is not a number"),
        (["two.csv"], "controller_output fits 2 columns, 'A.OP [%]', 'B.OP [%]': say which"),
        (["tags.csv"], "controller_output=HEADER,process_value=HEADER"),
        (["tags.csv", "--map", "process_value=LC74_20PV"], "no column is surely controller_output"),
        (
            ["tags.csv", "--map", "process_value=LC74_20PV,controller_output=LC74_20CV"],
            "the time in column 't' has no unit",
        ),
        (["empty.csv", "--map", "process_value=LC75"], "empty.csv: there is no table of numbers below a header line"),
        (["none.csv", "--map", "process_value=LC75"], "none.csv: there is no such file"),
        (["tags.csv", "--map", "process_value=LC75"], "the file has 't', 'LC74_20CV', 'LC74_20PV': give one"),
    ],
)
def test_what_cannot_be_read_is_one_sentence_with_its_remedy(run: Run, arguments: list[str], words: str) -> None:
    outcome = run(*arguments)
    assert outcome.returncode == 1, outcome.stdout
    assert words in " ".join(outcome.stderr.split())
    assert "Traceback" not in outcome.stderr


def test_a_file_with_a_stem_position_is_judged_by_its_stem(run: Run) -> None:
    outcome = run("stem.csv", "--json", "-")
    assert "loop" not in outcome.stdout
    assert "process_value" not in outcome.stderr
