"""Real-time precedence while a valve is polled: who has it, who has not, and who loses it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivers.motion.precedence import BESIDE, LOOP, Precedence
from service.routes.metrics import PrecedenceCollector

PROJECT = Path(__file__).resolve().parents[2]


def _seen(what: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "tests.service.precedence_probe", what],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
        cwd=PROJECT,
    )
    seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return {**seen, "said": done.stdout}


@pytest.fixture(scope="module")
def _allowed() -> None:
    if not _seen("motion")["allowed"]:
        pytest.skip("the system allows this user no real-time scheduling")


@pytest.mark.usefixtures("_allowed")
def test_in_a_motion_the_loop_comes_first_its_threads_behind_it_and_its_children_not_at_all() -> None:
    seen = _seen("motion")
    assert seen["loop"] == [os.SCHED_RR, LOOP]
    assert seen["others"] == [[os.SCHED_RR, BESIDE]] * 2  # also the one that was started in the motion
    assert BESIDE < LOOP
    assert seen["child"] == os.SCHED_OTHER
    assert seen["at_once"] == [os.SCHED_RR, LOOP]  # while the recording is put together
    assert seen["after"] == [[os.SCHED_OTHER, 0]] * 3
    assert seen["said"].count("polling has precedence") == 1


@pytest.mark.usefixtures("_allowed")
def test_a_loop_that_never_waits_loses_it_and_has_it_again_when_it_turns() -> None:
    seen = _seen("spin")
    assert 0.5 < seen["lasted_s"] < 5.0
    assert seen["again"]
    assert seen["closed"]
    assert seen["said"].count("a thread kept its core") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="there is no such thing")
def test_where_the_system_refuses_polling_goes_on_as_ordinary_and_the_log_says_so_once() -> None:
    seen = _seen("refused")
    assert (seen["loop"], seen["allowed"]) == ([os.SCHED_OTHER, 0], False)
    assert seen["said"].count("polling has no precedence") == 1


def test_motions_that_overlap_have_it_until_the_last_one_ends() -> None:
    told: list[str] = []

    class Told(Precedence):
        def begin(self) -> None:
            told.append("begin")

        def end(self) -> None:
            told.append("end")

    polling = Told()
    with polling.motion():
        with polling.motion():
            pass
        assert told == ["begin", "begin"]
    assert told == ["begin", "begin", "end"]


@pytest.mark.parametrize("allowed", [True, False])
def test_metrics_tell_whether_the_system_allows_it(allowed: bool) -> None:
    (family,) = PrecedenceCollector(allowed).collect()
    assert [(sample.name, sample.value) for sample in family.samples] == [
        ("breakaway_polling_precedence", float(allowed))
    ]
