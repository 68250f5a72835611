from __future__ import annotations

import pytest

from tests.bench.compose import unit
from tests.bench.compose.__main__ import refusal


def test_the_unit_is_installed_by_the_commands_of_the_page_in_their_order() -> None:
    steps = unit.steps(unit.PAGE.read_text(encoding="utf-8"))
    beginnings = (
        "git clone ADDRESS /opt/breakaway && make",
        "useradd",
        "install",
        "install",
        "systemctl daemon-reload",
    )
    assert [step.startswith(beginning) for step, beginning in zip(steps, beginnings, strict=True)] == [True] * 5


@pytest.mark.parametrize(
    "said",
    [
        "runc: error setting rlimits for ready process: error setting rlimit type 14: operation not permitted",
        "crun: setrlimit `RLIMIT_RTPRIO`: Operation not permitted: OCI permission denied",
    ],
)
def test_an_engine_that_may_not_raise_a_limit_is_told_from_one_that_fails(said: str) -> None:
    assert refusal(f"up -d: 3f\nError: {said}\nmore") == f"Error: {said}"
    assert not refusal("Error: port 8321 is in use\nError: setrlimit: invalid argument\nmount: operation not permitted")
