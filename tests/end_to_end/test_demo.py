"""The whole way, as a new user goes it: processes, Modbus TCP and RTU, REST, recording, analysis."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from datetime import datetime
from typing import Any

import pytest

from tests.pace import Pace

# The contract grants `breakaway demo --once` 90 s on a machine of its own. Here other tests run beside it: what counts
# is how long its valves moved and half of the processor time of all its processes, as on two cores that are its own.
# The same work takes up to twice the processor time beside others (51 s alone, 87 and 104 s met): so does a small piece
# of fixed work that is done meanwhile, and its slowdown is taken off (87 s with 1.78 give 49 s).
TIME_LIMIT_S = 90.0
CORES = 2
HANGS_S = 900.0


@pytest.fixture(scope="module")
def demonstration() -> dict[str, Any]:
    before_s = _processor_time_of_children_s()
    command = [sys.executable, "-m", "service.cli", "demo", "--once", "--json"]
    with Pace() as pace:
        done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)
    used_s = _processor_time_of_children_s() - before_s
    assert done.returncode == 0, done.stderr[-3000:]
    answer: dict[str, Any] = json.loads(done.stdout)
    moved_s = max(_moved_s(made["test"]) for made in answer["valves"])
    answer["took_s"] = moved_s + used_s / pace.slowdown / CORES
    return answer


def _processor_time_of_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _moved_s(test: dict[str, Any]) -> float:
    began, ended = (datetime.fromisoformat(test[name]) for name in ("created_at", "motion_ended_at"))
    return (ended - began).total_seconds()


def _error_percent(made: dict[str, Any], method: str, symbol: str) -> float:
    estimate = next(entry for entry in made["test"]["analysis"]["estimates"] if entry["method"] == method)
    value = estimate["parameters"][symbol]["value"]
    assert value is not None, estimate["parameters"][symbol]["note"]
    truth = made["truth"][symbol]
    return abs(100.0 * (float(value) - float(truth)) / float(truth))


def test_every_valve_is_tested_over_its_wire_within_the_time_limit(demonstration: dict[str, Any]) -> None:
    assert [made["transport"] for made in demonstration["valves"]] == ["tcp", "tcp", "tcp", "rtu"]
    assert {made["test"]["state"] for made in demonstration["valves"]} == {"completed"}
    assert demonstration["took_s"] <= TIME_LIMIT_S


@pytest.mark.parametrize("method", ["regression", "garcia"])
def test_both_methods_recover_spring_rate_and_friction_over_the_wire(
    demonstration: dict[str, Any], method: str
) -> None:
    for made in demonstration["valves"]:
        assert _error_percent(made, method, "k") < 0.1, made["tag"]
    for made in demonstration["valves"][1:3]:  # sticky valves sampled at 1 ms
        assert _error_percent(made, method, "F_c") < 1.0, made["tag"]
        assert _error_percent(made, method, "F_s") < 1.0, made["tag"]
        assert _error_percent(made, method, "F_v") < 5.0, made["tag"]
        assert _error_percent(made, method, "m") < 15.0, made["tag"]


def test_captured_recordings_are_at_one_millisecond_and_without_gaps(demonstration: dict[str, Any]) -> None:
    for made in demonstration["valves"][:3]:
        recording = made["test"]["analysis"]["recording"]
        assert recording["sample_period_s"] == pytest.approx(0.001, rel=1e-6)
        assert recording["samples"] >= 40_000
        assert recording["gaps"] == 0


def test_the_polled_valve_does_not_pretend_to_know_its_mass(demonstration: dict[str, Any]) -> None:
    polled = demonstration["valves"][3]
    for estimate in polled["test"]["analysis"]["estimates"]:
        mass = estimate["parameters"]["m"]
        if estimate["method"] == "maximum_likelihood" and mass["value"] is not None:
            # Slow samples of the whole motion may hold the mass: then with an interval that is honest about it. Noise
            # and instants differ with each run, so one run in twenty lies outside a true interval: within twice its
            # half-width is asked (one miss in ten thousand), and that it pretends to no better than 5 %.
            low, high = mass["ci95"]
            assert abs(mass["value"] - polled["truth"]["m"]) <= high - low
            assert high - low >= 0.1 * mass["value"]
            continue
        assert mass["value"] is None
        assert not mass["identifiable"]
        assert mass["note"]
