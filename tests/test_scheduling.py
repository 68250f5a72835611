"""Who runs what: tests that wait have workers of their own, and no file is left behind."""

from __future__ import annotations

from collections import OrderedDict
from types import SimpleNamespace
from typing import Any

import pytest

from tests.scheduling import WaitingBeside


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
        (["tests/blind/a.py", "tests/drivers/b.py"], "tests/blind/a.py", "tests/drivers/b.py"),
        (["tests/drivers/b.py", "tests/valve/c.py"], "tests/valve/c.py", "tests/drivers/b.py"),
        (["tests/drivers/b.py", "tests/faults/d.py"], "tests/drivers/b.py", "tests/drivers/b.py"),
        (["tests/blind/a.py", "tests/valve/c.py"], "tests/blind/a.py", None),
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
    scheduling = _scheduling(["tests/blind/a.py", "tests/drivers/b.py"], [_node(0), _node(2)])
    assert scheduling._next_file(_node(2)) == "tests/blind/a.py"
