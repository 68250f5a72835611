"""The bent valley of a stem that jumps: unknowns that straighten it, and a descent that stays in it to its bottom."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.likelihood.bent_valley import chart_of, descend_bent, usual_rate
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.search import with_events
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

SEED = 2418  # 72 jumps of 0.5 mm, seen to 1 um
ENOUGH = 4000


def test_the_charted_unknowns_lead_back_to_the_same_point() -> None:
    problem, _motion = posed(SEED)
    model, point = at_truth(problem, random_test(SEED))
    chart = chart_of(model, point)
    own = chart.charted(point)
    assert own is not None
    assert chart.point(own) == pytest.approx(point, rel=1.0e-12)
    truth = random_test(SEED).truth
    names = problem.model.coordinates.names
    risen_n = math.sqrt(2.0 * truth.mass_kg * truth.limit_velocity_m_per_s * chart.rate_n_per_s)
    assert math.exp(own[names.index("F_c")]) == pytest.approx(truth.static_friction_n + risen_n, rel=1.0e-3)
    slopes, step = chart.slopes(own), np.zeros(own.size)
    assert slopes is not None
    for number in range(own.size):
        step[number] = 1.0e-5
        beside = chart.point(own + step)
        assert beside is not None
        assert (beside - point) * 1.0e5 == pytest.approx(slopes[number], rel=1.0e-3, abs=1.0e-3)
        step[number] = 0.0


def test_a_stem_without_stiction_has_no_jumps_to_chart() -> None:
    problem, _motion = posed(SEED)
    model, point = at_truth(problem, random_test(SEED))
    flat = point.copy()
    flat[model.coordinates.names.index("d")] = 0.0
    assert chart_of(model, flat).charted(flat) is None
    ended = descend_bent(compressed(model), flat, most_simulations=100, arrived=1.0)
    assert np.array_equal(ended.point, flat)
    assert not ended.arrived


def test_a_descent_follows_the_bent_valley_to_its_bottom_where_a_straight_one_stays_behind() -> None:
    problem, motion = posed(SEED)
    model, truth = at_truth(problem, random_test(SEED))
    small = compressed(with_events(model, len(motion.phases.breakaways)))
    # a place of the valley with the F_v of a lower damping, where a search once ended: 11 % off
    values = small.coordinates.values(truth) | {"m": 5.55506, "F_v": 4806.56, "F_c": 5506.29, "d": 0.256413}
    behind = descend(small, small.coordinates.point(values), most_steps=12, one_sided=True)
    bottom = descend(small, truth, most_steps=12)
    straight = descend(small, behind.point, most_steps=30)
    bent = descend_bent(small, behind.point, most_simulations=ENOUGH, arrived=0.3)
    assert straight.cost > bottom.cost + 400.0
    assert bent.cost < bottom.cost + 8.0  # small sills are where the rounding has them
    # it ends by itself: whether with a last small step or without one is the rounding's
    assert bent.simulations < ENOUGH
    assert small.coordinates.values(bent.point)["F_v"] == pytest.approx(4316.9, rel=0.03)


def test_the_usual_rate_is_that_of_most_of_the_ramps_time() -> None:
    time_s = np.array([0.0, 1.0, 11.0, 11.0, 21.0, 22.0, 30.0])
    force_n = np.array([0.0, 0.0, 1000.0, 1500.0, 500.0, 500.0, 4500.0])
    assert usual_rate(time_s, force_n) == pytest.approx(100.0)
    assert usual_rate(time_s, np.zeros(7)) == 0.0
