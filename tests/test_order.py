"""Which tests lie beside which, and that what is left out of the quick ones is there."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.order import grouped, is_slow, slow

HERE = Path(__file__).parent


class Asked(SimpleNamespace):
    """A test as the order sees it."""

    def add_marker(self, mark: pytest.MarkDecorator) -> None:
        self.group = mark.args[0]


def test_files_of_all_folders_come_in_turn_and_browser_and_whole_processes_first() -> None:
    names = [
        "browser/a",
        "browser/b",
        "drivers/a",
        "drivers/b",
        "end_to_end/a",
        "valve/a",
        "valve/b",
        "valve/c",
        "valve/d",
    ]
    asked: list[Any] = [Asked(path=HERE / f"{name}.py", number=number) for name in names for number in range(2)]
    found: list[Any] = grouped(asked)
    files = [one.path.relative_to(HERE).with_suffix("").as_posix() for one in found]
    assert files[::2] == files[1::2]
    assert files[::2] == [
        *("browser/a", "browser/b", "end_to_end/a"),
        *("valve/a", "drivers/a", "valve/b", "valve/c", "drivers/b", "valve/d"),
    ]
    assert [one.number for one in found] == [0, 1] * len(names)
    assert {one.group for one in asked[:4]} == {"browser"}
    assert {one.group for one in asked[4:6]} == {"drivers/a"}


def test_what_is_left_out_of_the_quick_tests_is_there() -> None:
    assert [name for name in slow() if not is_slow(HERE / name)] == []
    assert [name for name in slow() if not (HERE / name).exists()] == []
    assert list(slow()) == sorted(slow())
    assert not is_slow(Path(__file__))
