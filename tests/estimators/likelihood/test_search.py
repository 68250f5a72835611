"""The search begins where the recording shows it, and is not led astray by parts, chatter or kinks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.arrival import arrived, left_to_gain
from estimators.likelihood.budget import Budget
from estimators.likelihood.certificate import Certificate
from estimators.likelihood.compression import compressed, in_parts, without_outliers
from estimators.likelihood.coordinates import Coordinates, linear
from estimators.likelihood.pool import Place, halved
from estimators.likelihood.search import Found
from estimators.samples import BoolArray, FloatArray
from tests.estimators.likelihood.computed_model import ComputedModel
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

pytestmark = pytest.mark.long


def test_a_few_parts_with_a_jump_too_many_do_not_lead_the_search_astray() -> None:
    problem, _ = posed(2253)
    model, truth = at_truth(problem, random_test(2253))
    model.corners(model.coordinates.values(truth))
    position_m = problem.rests.position_m.copy()
    position_m[::10] += 0.01 * model.range_m  # as a rest too noisy to be one adds a jump, or takes one off
    parts = compressed(in_parts(model, replace(problem.rests, position_m=position_m), 4))
    kept = without_outliers(parts, truth)
    dropped = np.count_nonzero(kept.weight == 0.0)
    assert 0 < dropped < 0.3 * parts.weight.size
    assert kept.cost(truth) < 0.01 * parts.cost(truth)
    whole = compressed(model)
    assert without_outliers(whole, truth) is whole


def test_a_stem_that_chatters_too_often_to_be_followed_is_tried_with_a_lower_limit_velocity() -> None:
    # an overdamped stem: above the speed of its ramps DV makes it creep in countless jumps
    problem, _ = posed(2252)
    model, truth = at_truth(problem, random_test(2252))
    small = replace(compressed(model), most_events=580)
    values = small.coordinates.values(truth)
    chattering = small.coordinates.point(values | {"m": 11.7, "F_v": 2.83e5, "F_c": 145.0, "d": 0.09, "DV": 9.15e-4})
    assert small.cost(chattering) == math.inf
    places = halved([small], [Place(chattering, 0.0)], Budget.limited(1.0e6))
    assert math.isfinite(places[0].cost)


# 24 jumps in 1162 rows, 34 in 3083: the second search ended for want of work, so that only k and F_0 were given.
# 2583: the first one ends 630,000 above the second, to which one from the rivals of the best comes back.
@pytest.mark.parametrize(
    ("seed", "symbols"),
    [(2327, ("m", "F_s")), (2334, ("m", "F_v", "F_c", "F_s")), (2583, ("m", "F_v", "F_c", "F_s"))],
)
def test_a_stem_that_jumps_is_searched_until_two_searches_agree(seed: int, symbols: tuple[str, ...]) -> None:
    test = random_test(seed)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert "searches from other starts" not in estimate.message
    for symbol in symbols:
        entry, truth = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.value is not None
        assert entry.std_error is not None
        assert abs(entry.value - truth) < 4.0 * entry.std_error < 0.4 * truth


def test_searches_that_agree_are_not_doubted_for_a_delay_that_is_found_after_them() -> None:
    # the pressure was read 0.3 ms late: without that the best of either search misses the jumps by a little
    test = random_test(2266)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    assert estimate.value("F_v") == pytest.approx(test.truth.viscous_friction_n_s_per_m, rel=0.1)


def test_a_first_velocity_that_the_stem_forgets_at_once_does_not_keep_the_fit_from_its_bottom() -> None:
    # sections of a polled file that begin in motion, m/F_v a hundredth of the period
    test = random_test(2263)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    for symbol in ("F_v", "F_c", "F_s"):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=0.01)


def test_ringing_that_is_sampled_slower_than_it_swings_is_found_among_its_likenesses() -> None:
    # 52 Hz at 50 ms: the search ended at 0.2 kg and explained nothing; the truth has 4.6 kg
    test = random_test(2485)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    for symbol in ("m", "F_v", "F_c"):
        entry, truth = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.value is not None
        assert entry.std_error is not None
        assert abs(entry.value - truth) < 4.0 * entry.std_error < 0.5 * truth


class _Held:
    def corners(self, _values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([0.0, 1.0]), np.zeros(2)


class _Toothed(ComputedModel):
    """Two residuals that are even at 0, and fine teeth on one of them."""

    def simulate_each(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        x = points[:, 0]
        simulated_m = np.stack([x - 3.0 + 1.0e-4 * np.sin(1.0e5 * x), x + 3.0], axis=1)
        return simulated_m, np.ones(x.size, dtype=np.bool_)


def toothed(x: float) -> Found:
    model = _Toothed(
        time_s=np.arange(2.0),
        position_m=np.zeros(2),
        weight=np.ones(2),
        path=_Held(),
        coordinates=Coordinates((linear("x", 1.0),)),
        section_row=np.zeros(1, dtype=np.int64),
        input_names=(),
        range_m=1.0,
    )
    point = np.array([x])
    return Found(model, point, model.cost(point), Certificate(1.0, 1.0, 2), (), 1.0, 1, 1, 1.0)


def test_teeth_of_the_cost_are_no_slope() -> None:
    assert left_to_gain(toothed(0.0)) > 4.0
    found, is_bottom = arrived(toothed(0.0))
    assert is_bottom
    assert found.point[0] == pytest.approx(0.0, abs=0.05)
    assert left_to_gain(toothed(2.0), 1.0e-3) > 4.0
