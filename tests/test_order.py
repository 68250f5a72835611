"""Which tests lie beside which, and that what is left out of the quick ones is there."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.order import FilesAndOneBrowser, in_turn, is_slow, slow

HERE = Path(__file__).parent


def test_files_of_all_folders_come_in_turn_and_browser_and_whole_processes_first() -> None:
    names = ["browser/a", "drivers/a", "drivers/b", "end_to_end/a", "valve/a", "valve/b", "valve/c", "valve/d"]
    asked: list[Any] = [SimpleNamespace(path=HERE / f"{name}.py", number=n) for name in names for n in range(2)]
    found: list[Any] = in_turn(asked)
    files = [one.path.relative_to(HERE).with_suffix("").as_posix() for one in found]
    assert files[::2] == files[1::2]
    assert files[::2] == [
        *("browser/a", "end_to_end/a"),
        *("valve/a", "drivers/a", "valve/b", "valve/c", "drivers/b", "valve/d"),
    ]
    assert [one.number for one in found] == [0, 1] * len(names)


@pytest.mark.parametrize(
    ("nodeid", "unit"),
    [
        ("tests/browser/test_pages.py::test_one[/ui/night]", "tests/browser"),
        ("tests/browser/test_tablet.py::test_two", "tests/browser"),
        ("tests/drivers/test_gate.py::test_one[a::b]", "tests/drivers/test_gate.py"),
    ],
)
def test_a_file_is_one_piece_of_work_and_all_in_a_browser_are_one(nodeid: str, unit: str) -> None:
    assert FilesAndOneBrowser.__new__(FilesAndOneBrowser)._split_scope(nodeid) == unit


def test_what_is_left_out_of_the_quick_tests_is_there() -> None:
    assert [name for name in slow() if not is_slow(HERE / name)] == []
    assert [name for name in slow() if not (HERE / name).exists()] == []
    assert list(slow()) == sorted(slow())
    assert not is_slow(Path(__file__))
