"""Who runs what: tests that wait have workers of their own; and that what is left out of the quick ones is there."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.order import WAITING, WaitingBeside, is_slow, slow

HERE = Path(__file__).parent


def _node(number: int) -> Any:
    return SimpleNamespace(gateway=SimpleNamespace(id=f"gw{number}"))


def _scheduling(files: list[str], nodes: list[Any]) -> WaitingBeside:
    scheduling = WaitingBeside.__new__(WaitingBeside)
    scheduling.workqueue = OrderedDict((file, {}) for file in files)
    scheduling.assigned_work = {node.gateway.id: {} for node in nodes}
    return scheduling


@pytest.mark.parametrize(
    ("files", "first", "third"),
    [
        (["tests/bench/blind/a.py", "tests/drivers/b.py"], "tests/bench/blind/a.py", "tests/drivers/b.py"),
        (["tests/drivers/b.py", "tests/valve/c.py"], "tests/valve/c.py", "tests/drivers/b.py"),
        (["tests/drivers/b.py", "tests/bench/faults/d.py"], "tests/drivers/b.py", "tests/drivers/b.py"),
        (["tests/bench/blind/a.py", "tests/valve/c.py"], "tests/bench/blind/a.py", None),
        (["tests/service/d.py", "tests/valve/c.py"], "tests/valve/c.py", "tests/service/d.py"),
        (["tests/service/d.py", "tests/drivers/b.py"], "tests/service/d.py", "tests/drivers/b.py"),
    ],
)
def test_workers_from_the_third_on_wait_and_the_others_compute_first(
    files: list[str], first: str, third: str | None
) -> None:
    nodes = [_node(number) for number in range(4)]
    scheduling = _scheduling(files, nodes)
    assert [scheduling._next_file(node) for node in nodes] == [first, first, third, third]


def test_of_two_workers_none_stands_aside() -> None:
    scheduling = _scheduling(["tests/bench/blind/a.py", "tests/drivers/b.py"], [_node(0), _node(2)])
    assert scheduling._next_file(_node(2)) == "tests/bench/blind/a.py"


def test_what_waits_is_there() -> None:
    assert [name for name in WAITING if not (HERE.parent / name).exists()] == []


def test_what_is_left_out_of_the_quick_tests_is_there() -> None:
    assert [name for name in slow() if not is_slow(HERE / name)] == []
    assert [name for name in slow() if not (HERE / name).exists()] == []
    assert list(slow()) == sorted(slow())
    assert not is_slow(Path(__file__))
