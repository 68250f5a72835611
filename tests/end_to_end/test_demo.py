"""The whole way, as a new user goes it: processes, Modbus TCP and RTU, REST, recording, analysis."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from service.cli.demo_plant import DEMO_VALVES, DemoValve

HANGS_S = 900.0


pytestmark = pytest.mark.long  # its six valves take two minutes of a core


@pytest.fixture(scope="module")
def demonstration() -> dict[str, Any]:
    command = [sys.executable, "-m", "service.cli", "demo", "--once", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    answer: dict[str, Any] = json.loads(done.stdout)
    assert [made["tag"] for made in answer["valves"]] == [valve.tag for valve in DEMO_VALVES]
    return answer


def _valve(made: dict[str, Any]) -> DemoValve:
    return next(valve for valve in DEMO_VALVES if valve.tag == made["tag"])


def _parameters(made: dict[str, Any], method: str) -> dict[str, Any]:
    estimate = next(entry for entry in made["test"]["analysis"]["estimates"] if entry["method"] == method)
    parameters: dict[str, Any] = estimate["parameters"]
    return parameters


def test_every_valve_is_tested_over_its_wire(demonstration: dict[str, Any]) -> None:
    for made in demonstration["valves"]:
        assert made["transport"] == _valve(made).transport
    assert {made["transport"] for made in demonstration["valves"]} == {"tcp", "rtu"}
    assert {made["test"]["state"] for made in demonstration["valves"]} == {"completed"}


@pytest.mark.parametrize("method", ["regression", "garcia", "maximum_likelihood"])
def test_every_method_gives_spring_rate_and_friction_of_usual_valves(
    demonstration: dict[str, Any], method: str
) -> None:
    """Noise and instants differ with each run: intervals are judged by the benchmark of rough valves, here by far."""
    is_likelihood = method == "maximum_likelihood"
    for made in (made for made in demonstration["valves"] if _valve(made).cause is None):
        truth = made["truth"]
        for symbol, most in (
            ("k", 0.04),
            ("F_c", 0.06 if is_likelihood else 0.4),
            ("F_s", 0.12 if is_likelihood else 0.4),
        ):
            one = _parameters(made, method)[symbol]
            if symbol == "F_s" and is_likelihood and _valve(made).mode == "polled" and one["value"] is None:
                continue  # by where the rows fell between which the stem broke away
            assert one["value"] is not None, (made["tag"], symbol, one["note"])
            low, high = one["ci95"]
            off = abs(one["value"] - truth[symbol])
            assert off <= most * truth[symbol], (made["tag"], symbol)
            assert off <= max(1.5 * (high - low), 0.02 * truth[symbol]), (made["tag"], symbol)
        static = _parameters(made, method)["F_s"]
        assert (static["scatter"] is None) == (static["value"] is None)


def test_the_truth_says_what_is_wrong_and_no_healthy_valve_is_named(demonstration: dict[str, Any]) -> None:
    for made in demonstration["valves"]:
        hidden = _valve(made).cause
        assert made["truth"]["cause"] == hidden
        found = [cause["cause"] for cause in made["test"]["analysis"]["discrepancy"]["causes"]]
        assert found == ([] if hidden is None else [hidden]), made["tag"]


def test_captured_recordings_are_at_one_millisecond_and_without_gaps(demonstration: dict[str, Any]) -> None:
    for made in (made for made in demonstration["valves"] if _valve(made).mode == "captured"):
        recording = made["test"]["analysis"]["recording"]
        assert recording["sample_period_s"] == pytest.approx(0.001, rel=1e-6)
        assert recording["samples"] >= 36_000
        assert recording["gaps"] == 0


def test_the_polled_valve_does_not_pretend_to_know_its_mass(demonstration: dict[str, Any]) -> None:
    (polled,) = (made for made in demonstration["valves"] if _valve(made).mode == "polled")
    for estimate in polled["test"]["analysis"]["estimates"]:
        mass = estimate["parameters"]["m"]
        if estimate["method"] == "maximum_likelihood" and mass["value"] is not None:
            # Slow samples of the whole motion may hold the mass: then with an interval that pretends to no better than
            # 5 %. Whether such intervals hold is not for one draw to say: `make bench ARGS=rough_valves` counts it.
            low, high = mass["ci95"]
            assert high - low >= 0.1 * mass["value"]
            continue
        assert mass["value"] is None
        assert not mass["identifiable"]
        assert mass["note"]
