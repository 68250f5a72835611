"""A stem that jumps: searched with its whole motion, and given only where searches apart come to the same fit."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from estimators.base import Estimate, Outcome, Status
from estimators.likelihood import confirmation, search
from estimators.likelihood.input_path import input_path
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.problem import pose
from estimators.likelihood.staircase import read_staircase
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.motion.recorded_motion import read_motion
from tests.benchmarks.random_valves import what_is_wrong
from tests.estimators.random_valves import random_test

SEED = 2035  # 49 jumps at one rate; a fit behind the sill has F_v wrong by 37 %, and its interval is 4 % wide


def estimated() -> Estimate:
    test = random_test(SEED)
    return MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)


def test_a_stem_that_jumps_is_followed_over_the_sill_to_the_lowest_fit() -> None:
    estimate, truth = estimated(), random_test(SEED).truth.by_symbol()
    assert estimate.status is Status.OK, estimate.message
    # rounding moves F_v by 1 % along the valley's floor
    for symbol, percent in (("m", 1.0), ("F_v", 8.0), ("F_c", 0.4), ("F_s", 0.2)):
        assert estimate.value(symbol) == pytest.approx(truth[symbol], rel=0.01 * percent), symbol


def test_what_only_one_search_came_to_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    # the second search ends elsewhere, 100 above, and the third one too
    real = confirmation.are_as_low

    def other(small: StemModel, best: Place, apart: list[Place], ratio: float) -> bool:
        far = Place(small.coordinates.point(small.coordinates.values(best.point) | {"F_v": 300.0}), 0.0)
        assert real(small, best, apart, ratio)
        return real(small, best, [far], ratio)

    monkeypatch.setattr(confirmation, "are_as_low", other)
    estimate = estimated()
    assert estimate.status is Status.POOR
    assert "searches from other starts" in estimate.message
    for symbol in ("m", "F_v", "F_c", "F_s", "DV"):
        assert estimate.value(symbol) is None, symbol
    assert estimate.value("k") == pytest.approx(random_test(SEED).truth.spring_rate_n_per_m, rel=1.0e-3)


# 2294 jumps in a minute; 227 seen, and ten times as many that the noise hides
@pytest.mark.parametrize("seed", [2215, 2133])
def test_a_stem_of_thousands_of_jumps_is_followed(seed: int) -> None:
    test = random_test(seed)
    motion = read_staircase(test.recording, test.nameplate, read_motion(test.recording, test.nameplate))
    path = input_path(test.recording, test.nameplate)
    assert motion is not None
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    model, truth = problem.model, test.truth.by_symbol()
    values = {
        **problem.trials[0].values,
        **truth,
        "d": truth["F_s"] / truth["F_c"] - 1.0,
        "x_0": test.initial.position_m,
    }
    point = model.coordinates.point(values)
    assert model.simulate(point) is None
    followed = search.with_events(model, len(motion.phases.breakaways))
    assert followed.simulate(point) is not None
    assert followed.cost(point) < 2.0 * motion.samples.count


class _Costs:
    """The first unknown is the cost."""

    @staticmethod
    def cost(point: np.ndarray) -> float:
        return float(point[0])


def test_searches_apart_agree_within_what_the_noise_leaves_open() -> None:
    small = cast("StemModel", _Costs())
    best, near, far = (Place(np.array([cost]), 0.0) for cost in (100.0, 108.0, 137.0))
    assert confirmation.are_as_low(small, best, [best, near], 1.0)
    assert not confirmation.are_as_low(small, best, [best, far], 1.0)
    assert not confirmation.are_as_low(small, best, [], 1.0)
    assert confirmation.are_as_low(small, best, [best, far], 3.0)


def test_jumps_are_hopped_from_anew_with_the_errors_of_the_pressure() -> None:
    # without these errors the lowest place has an F_v 28 % too low; with them the true one costs 8 less: it was ok
    test = random_test(2660)
    estimate = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)
    assert what_is_wrong(estimate, test) == ()
    assert estimate.value("F_v") is not None
