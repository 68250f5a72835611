"""Jumps that begin anew at their rests lead to the whole motion only step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.delay import searched_model
from estimators.likelihood.descent import descend
from estimators.likelihood.horizon import led_on
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place
from estimators.likelihood.search import with_events
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

SEED = 2792  # 389 jumps of 0.5 mm in a minute of several rates
# Where searches end that begin the jumps anew at each rest: every jump fits, and their sum is beside the motion.
FROM_REST_TO_REST = {
    "m": 11.5285, "k": 206912.0, "F_v": 780.689, "F_c": 157.207, "d": 0.358221, "F_0": 4314.58, "DV": 6.46677e-07,
    "x_0": 0.00171884, "delay_s": 5.39626e-06,
}  # fmt: skip


@pytest.fixture(scope="module")
def whole() -> tuple[StemModel, StemModel, Restarts, float]:
    """Return the model, its blocks, the rests, and the cost of the true valve on blocks."""
    problem, motion = posed(SEED)
    model = with_events(searched_model(problem, motion.samples.period_s), len(motion.phases.breakaways))
    small = compressed(model)
    _, truth = at_truth(problem, random_test(SEED))
    return model, small, problem.rests, small.cost(truth)


def test_jumps_are_led_from_their_rests_to_the_whole_motion(
    whole: tuple[StemModel, StemModel, Restarts, float],
) -> None:
    model, small, rests, lowest = whole
    point = model.coordinates.point(FROM_REST_TO_REST)
    place = Place(point, small.cost(point))
    assert place.cost > 50.0 * lowest
    assert descend(small, point, most_steps=40).cost > 10.0 * lowest
    led = led_on(model, small, rests, place, Budget.limited(3.0e6))
    assert led.cost < 1.2 * lowest


def test_a_horizon_ends_where_its_budget_does(whole: tuple[StemModel, StemModel, Restarts, float]) -> None:
    model, small, rests, _ = whole
    point = model.coordinates.point(FROM_REST_TO_REST)
    budget = Budget.limited(1.0)
    led = led_on(model, small, rests, Place(point, small.cost(point)), budget)
    assert led.cost == small.cost(led.point)
    assert -1.0e6 < budget.left < 0.0


def test_a_part_of_the_motion_that_is_passed_counts_whatever_its_misfit(
    whole: tuple[StemModel, StemModel, Restarts, float],
) -> None:
    # what is out of step is worse than most parts, and would be left out as an outlier: then nothing leads it back
    model, small, rests, lowest = whole
    moved = replace(rests, position_m=rests.position_m + 1.0e-6 * np.cos(np.arange(rests.row.size)))
    point = model.coordinates.point(FROM_REST_TO_REST)
    led = led_on(model, small, moved, Place(point, small.cost(point)), Budget.limited(3.0e6))
    assert led.cost < 1.2 * lowest
