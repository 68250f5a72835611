"""Friction, breakaway and bands of simulated loops lie within their intervals, at all usual rates of rows."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import pytest

from estimators.in_service.figure import Figure
from estimators.in_service.result import Scale, Watched
from estimators.in_service.watch import watched
from tests.estimators.in_service.records import (
    AREA_M2,
    BREAKAWAY_PA,
    FRICTION_PA,
    PLATE,
    SPRING_PA_PER_M,
    TRAVEL_M,
    Noise,
    record,
)
from tests.support.loops import Loop, loop

SCALE = Scale(TRAVEL_M, AREA_M2)
SILENT = Noise(0.0, 0.0)


@cache
def exact(period_s: float) -> Watched:
    return watched(record(1.0, period_s), PLATE, SCALE, subject="record")


@cache
def simulated(valve: str, period_s: float) -> tuple[Loop, Watched]:
    made = loop(valve, 1.0, period_s, 11)
    actuator = made.nameplate.actuator
    scale = Scale(actuator.travel_m, actuator.diaphragm_area_m2)
    return made, watched(made.recording, made.nameplate, scale, subject="loop")


def holds(one: Figure, truth: float, within: float) -> bool:
    """Whether the interval, half as wide again, holds the truth, and the value is that near to it."""
    assert one.value is not None, one.note
    assert one.ci95 is not None
    half = 0.5 * (one.ci95[1] - one.ci95[0])
    assert half < 0.25 * truth, f"{one.value} ± {half} says little of {truth}"
    return abs(one.value - truth) <= min(1.5 * half, within * truth)


@pytest.mark.parametrize("period_s", [0.02, 0.1, 1.0])
def test_friction_and_breakaway_of_an_exact_stick_slip_stem_are_recovered(period_s: float) -> None:
    figures = exact(period_s).figures
    assert holds(figures["friction"], AREA_M2 * FRICTION_PA, 0.05), figures["friction"]
    assert holds(figures["breakaway"], AREA_M2 * BREAKAWAY_PA, 0.05), figures["breakaway"]
    assert holds(figures["breakaway_up"], AREA_M2 * BREAKAWAY_PA, 0.06), figures["breakaway_up"]
    assert holds(figures["breakaway_down"], AREA_M2 * BREAKAWAY_PA, 0.06), figures["breakaway_down"]


@pytest.mark.parametrize("period_s", [0.02, 0.1, 1.0])
def test_bands_and_spring_of_an_exact_stem_are_recovered(period_s: float) -> None:
    figures = exact(period_s).figures
    assert holds(figures["stick_band"], BREAKAWAY_PA + FRICTION_PA, 0.05), figures["stick_band"]
    assert holds(figures["slip_jump"], BREAKAWAY_PA - FRICTION_PA, 0.15), figures["slip_jump"]
    assert holds(figures["slip"], (BREAKAWAY_PA - FRICTION_PA) / SPRING_PA_PER_M, 0.1), figures["slip"]
    assert holds(figures["spring_rate"], AREA_M2 * SPRING_PA_PER_M, 0.05), figures["spring_rate"]
    dead = figures["dead_band"]
    assert dead.value is not None
    # from the signal's turn, so between the stick band and twice the breakaway
    assert 0.98 * (BREAKAWAY_PA + FRICTION_PA) <= dead.value <= 2.05 * BREAKAWAY_PA


def test_scatter_from_breakaway_to_breakaway_is_seen() -> None:
    calm = watched(record(1.0, 0.1, scatter=0.0), PLATE, SCALE, subject="record").figures["breakaway"]
    rough = watched(record(1.0, 0.1, scatter=0.08), PLATE, SCALE, subject="record").figures["breakaway"]
    assert calm.value is not None
    assert calm.scatter is not None
    assert rough.value is not None
    assert rough.scatter is not None
    assert calm.scatter < 0.015 * calm.value
    assert 0.05 * rough.value < rough.scatter < 0.11 * rough.value


@pytest.mark.parametrize(
    ("valve", "period_s"),
    [
        ("small", 0.02),
        *(pytest.param(*one, marks=pytest.mark.long) for one in [("small", 0.1), ("large", 0.1), ("large", 1.0)]),
    ],
)
def test_a_loop_of_a_usual_packing_gives_friction_within_its_interval(valve: str, period_s: float) -> None:
    made, found = simulated(valve, period_s)
    truth = made.truth.parameters
    assert holds(found.figures["friction"], truth.coulomb_friction_n, 0.08), found.figures["friction"]
    assert holds(found.figures["breakaway"], truth.static_friction_n, 0.08), found.figures["breakaway"]
    assert holds(found.figures["spring_rate"], truth.spring_rate_n_per_m, 0.1), found.figures["spring_rate"]


def test_travel_and_cycles_are_those_of_the_true_stem() -> None:
    clean = record(1.0, 0.1).position_m
    found = exact(0.1)
    truth = record(1.0, 0.1, noise=SILENT).position_m
    steps = [step for step in (truth[1:] - truth[:-1]).tolist() if step != 0.0]
    turns = sum(one * other < 0.0 for one, other in pairwise(steps))
    assert found.travel.total == pytest.approx(sum(abs(step) for step in steps), rel=0.01)
    assert found.travel.cycles == turns
    assert found.travel.shares.sum() == pytest.approx(1.0)
    assert found.travel.mean == pytest.approx(clean.mean(), rel=0.01)
