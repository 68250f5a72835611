"""What several workers run beside each other, and what ``make quick`` leaves out."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Final

import pytest
from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]

_HERE: Final = Path(__file__).parent
_BROWSER: Final = "browser"
# Both last for minutes, so they are not the last.
_FIRST: Final = (_BROWSER, "end_to_end")


class FilesAndOneBrowser(LoadFileScheduling):  # type: ignore[misc]  # it has no types
    """Each file on one worker, and all that need a browser on the same: it starts one, and not up to three.

    Beside pytest 9.2 xdist's ``loadgroup`` finds no ``xdist_group`` (pytest-xdist issue 1386); with one that does,
    marks can take the place of this class.
    """

    def _split_scope(self, nodeid: str) -> str:
        folder = f"{_HERE.name}/{_BROWSER}"
        return folder if nodeid.startswith(f"{folder}/") else str(super()._split_scope(nodeid))


def in_turn(items: list[pytest.Item]) -> list[pytest.Item]:
    """Return the tests with files of all folders in turn, and those of a file as they were.

    Some folders compute and some wait for motions in real time: spread evenly, as many workers do each at any time.
    """
    folders: dict[str, list[Path]] = defaultdict(list)
    for path in dict.fromkeys(item.path for item in items):
        folders[_name(path).split("/", maxsplit=1)[0]].append(path)
    turns = {
        path: 0.0 if folder in _FIRST else (number + 1) / len(paths)
        for folder, paths in folders.items()
        for number, path in enumerate(paths)
    }
    return sorted(items, key=lambda item: turns[item.path])


def _name(path: Path) -> str:
    return path.relative_to(_HERE).as_posix()


@cache
def slow() -> tuple[str, ...]:
    """Folders, with a stroke at their end, and files that take more than about two seconds of a core."""
    return tuple((_HERE / "slow.txt").read_text(encoding="utf-8").split())


def is_slow(path: Path) -> bool:
    """Whether a file or folder of tests is one of them."""
    if not path.is_relative_to(_HERE):
        return False
    return f"{_name(path)}{'/' if path.is_dir() else ''}" in slow()
