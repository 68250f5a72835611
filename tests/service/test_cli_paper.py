"""``breakaway paper``: where its tables, figures and JSON go. What they hold is tested with the methods."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from service.cli import main


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Path]:
    """Put a quick reproduction in place of the real one; the folders that figures were asked in."""
    folders: list[Path] = []

    def reproduce_paper(out_dir: Path) -> Any:
        folders.append(out_dir)
        document = {"tables": [{"table": 2}], "figures": []}
        return SimpleNamespace(to_json=lambda: document, render=_say)

    def _say(console: Console) -> None:
        console.print("Table 2")

    module = ModuleType("service.paper.paper")
    module.reproduce_paper = reproduce_paper  # type: ignore[attr-defined]  # a stand-in
    monkeypatch.setitem(sys.modules, "service.paper.paper", module)
    monkeypatch.chdir(tmp_path)
    return folders


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["breakaway", "paper", *arguments])
    try:
        main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    return 0


def test_tables_are_printed_and_json_is_written_beside(
    asked: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call(monkeypatch, "--out", "figures", "--json", "paper.json") == 0
    assert asked == [Path("figures")]
    assert "Table 2" in capsys.readouterr().out
    assert json.loads((tmp_path / "paper.json").read_text())["tables"] == [{"table": 2}]


def test_json_on_standard_output_stands_there_alone(
    asked: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["figures"] == []
    assert asked == [Path("paper")]


def test_a_json_file_in_no_folder_is_refused_before_the_work(
    asked: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, "--json", "none/paper.json") == 1
    assert "there is no folder none" in capsys.readouterr().err
    assert asked == []
