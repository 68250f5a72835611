"""No abort rule takes a valve in good order for a faulty one, whatever it is and whatever is played on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import pytest

from tests.bench.faults.healthy import Healthy, of_set, verdict, with_friction

GRAPHITE: Final = of_set("graphite", lag_s=0.933)
VALVES: Final = [
    GRAPHITE,
    of_set("rough", lag_s=0.3),
    with_friction("dead band of 80 %", 0.8, 600.0),
    with_friction("dead band of 90 %", 0.9, 600.0, lag_s=0.3),
    with_friction("nearly frictionless", 0.0005, 3.0),
    with_friction("nearly frictionless, with stops", 0.0005, 3.0, stops=True),
    of_set("nominal", lag_s=0.933, seen=False),
    with_friction("dead band of 80 %, pressure not measured", 0.8, 600.0, lag_s=0.933, seen=False),
]
LEAPS: Final = {"levels_percent": [0.0, 100.0] * 6}
SEQUENCES: Final[list[tuple[str, Mapping[str, Any]]]] = [
    ("steps", {"hold_s": 0.25}),
    ("steps", {**LEAPS, "hold_s": 0.25}),
    ("steps", {**LEAPS, "hold_s": 2.0}),
    ("sine", {"period_s": 5.0}),
    ("multi_rate", {}),
    ("dwell", {}),
    ("small_loops", {}),
    ("diagnostic", {}),
]


@pytest.mark.parametrize("valve", VALVES, ids=lambda one: one.name)
def test_no_sequence_on_a_healthy_valve_is_ended_when_the_device_plays_it(valve: Healthy) -> None:
    for sequence, overrides in SEQUENCES:
        assert verdict(valve, sequence, overrides, period_s=None) is None, sequence


@pytest.mark.parametrize("valve", VALVES, ids=lambda one: one.name)
def test_no_short_sequence_on_a_healthy_valve_is_ended_when_it_is_polled(valve: Healthy) -> None:
    for sequence, overrides in SEQUENCES[:4]:
        assert verdict(valve, sequence, overrides, period_s=0.05) is None, sequence


def test_a_graphite_valve_polled_at_50_hz_is_never_taken_for_a_stuck_one() -> None:
    assert verdict(GRAPHITE, "triangle", {"cycles": 1}, period_s=0.02) is None


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("period_s", [0.05, None])
def test_a_stem_that_is_stuck_is_still_told(seen: bool, period_s: float | None) -> None:
    stuck = with_friction("stuck", 4.0, 600.0, lag_s=0.3, seen=seen)
    fault = verdict(stuck, "triangle", {"cycles": 1}, period_s=period_s)
    assert "did not break away" in str(fault)
