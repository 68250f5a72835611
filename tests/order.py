"""What several workers run beside each other, and what ``make quick`` leaves out."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Final

import pytest

_HERE: Final = Path(__file__).parent
# One worker has one browser for all of them; and whole processes over minutes: the last tests are none of these.
_TOGETHER: Final = "browser"
_FIRST: Final = (_TOGETHER, "end_to_end")


def grouped(items: list[pytest.Item]) -> list[pytest.Item]:
    """Mark the tests of each file as one group, those in a browser too, and put files of all folders in turn.

    Some folders compute and some wait for motions in real time: spread evenly, as many workers do each at any time.
    """
    folders: dict[str, list[Path]] = defaultdict(list)
    for path in dict.fromkeys(item.path for item in items):
        folders[_folder(path)].append(path)
    turns = {
        path: 0.0 if folder in _FIRST else (number + 1) / len(paths)
        for folder, paths in folders.items()
        for number, path in enumerate(paths)
    }
    for item in items:
        name = _TOGETHER if _folder(item.path) == _TOGETHER else _name(item.path).removesuffix(".py")
        item.add_marker(pytest.mark.xdist_group(name))
    return sorted(items, key=lambda item: turns[item.path])


def _name(path: Path) -> str:
    return path.relative_to(_HERE).as_posix()


def _folder(path: Path) -> str:
    return _name(path).split("/", maxsplit=1)[0]


@cache
def slow() -> tuple[str, ...]:
    """Folders, with a stroke at their end, and files that take more than about two seconds of a core."""
    return tuple((_HERE / "slow.txt").read_text(encoding="utf-8").split())


def is_slow(path: Path) -> bool:
    """Whether a file or folder of tests is one of them."""
    if not path.is_relative_to(_HERE):
        return False
    return f"{_name(path)}{'/' if path.is_dir() else ''}" in slow()
