"""A fit that stopped on a slope is told from one at the bottom, and led on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.base import Outcome
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.arrival import arrived, left_to_gain
from estimators.likelihood.delay import searched_model
from estimators.likelihood.hopping import Hopping
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.problem import pose
from estimators.likelihood.search import Found, search
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from tests.estimators.random_valves import random_test
from tests.estimators.recordings import recorded


@pytest.fixture(scope="module")
def bottom() -> Found:
    test = recorded("nominal", period_s=5.0e-3, noise_m=20.0e-6, seed=7)
    motion = read_motion(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    path = input_path(test.recording, test.nameplate)
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    model = searched_model(problem, motion.samples.period_s)
    hopping = Hopping(motion.phases.moving_speed, problem.jumps)
    breakaways = len(motion.phases.breakaways)
    found = search(model, problem.trials, problem.rests, breakaways=breakaways, hopping=hopping)
    assert found is not None
    return found


def off_the_bottom(found: Found) -> Found:
    point = found.point.copy()
    point[found.model.coordinates.names.index("F_v")] += 0.05
    return replace(found, point=point, cost=found.model.cost(point))


def test_a_fit_at_the_bottom_promises_no_further_fall(bottom: Found) -> None:
    assert left_to_gain(bottom) < 1.0
    assert arrived(bottom) == (bottom, True)


def test_a_fit_on_the_slope_promises_a_fall_and_is_led_on(bottom: Found) -> None:
    off = off_the_bottom(bottom)
    assert left_to_gain(off) > 100.0
    led, is_bottom = arrived(off)
    assert is_bottom
    assert led.cost < bottom.cost + 1.0


def test_a_fit_that_cannot_be_led_on_is_not_called_arrived(bottom: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimators.likelihood.arrival._FURTHER_STEPS", 0)
    assert not arrived(off_the_bottom(bottom))[1]


def test_a_fit_that_went_on_down_is_judged_where_it_ended() -> None:
    # the search left 1.6 times the noise, and the last descent 1.0: what is given went by the first
    test = random_test(3372)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.diagnostics["misfit_over_noise"] == pytest.approx(1.0, abs=0.1)
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=0.001), estimate.message
