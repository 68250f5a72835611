"""Of a command alone dead time and friction stand for each other: the intervals hold all that explain the jumps."""

from __future__ import annotations

import pytest

from estimators.base import NORMAL_95
from estimators.exact_motion import ExactMotionEstimator
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.dead_time import about_middle_dead_time
from estimators.likelihood.descent import descend
from estimators.likelihood.inputs.transducer_path import DEAD_TIME, LAG
from estimators.likelihood.intervals import known
from estimators.likelihood.model import StemModel
from estimators.likelihood.ramps import ramps_of
from estimators.samples import FloatArray
from tests.benchmarks.random_valves import what_is_wrong
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

pytestmark = pytest.mark.long

JUMPING = 5664  # 0.21 s of dead time on ramps of one rate: a fit with 0.01 s and 87 N more friction leaves as much
SLIDING = 2693  # ramps of two rates


def at_best(seed: int) -> tuple[StemModel, FloatArray, Knowledge]:
    """Return the model, the bottom beside the true valve, and what its slopes say is known there."""
    test = random_test(seed)
    problem, motion = posed(seed)
    model, point = at_truth(problem, test)
    values = model.coordinates.values(point) | {LAG: test.lag_s, DEAD_TIME: test.dead_time_s}
    near = descend(model, model.coordinates.point(values), most_steps=20)
    knows = known(model, near.point, ramps_of(motion), noise_factor=1.0)
    assert knows is not None
    return model, near.point, knows


def test_the_friction_of_jumps_reaches_what_every_dead_time_makes_of_it() -> None:
    model, point, knows = at_best(JUMPING)
    assert knows.std_error("F_c") < 6.0
    centred = about_middle_dead_time(knows, model, point, 1.0)
    for symbol in ("F_c", "F_s"):
        low, high = (centred.value(symbol) + sense * NORMAL_95 * centred.std_error(symbol) for sense in (-1.0, 1.0))
        assert low < knows.value(symbol) < high
        assert high > knows.value(symbol) + 87.0  # and what the fit came to
    # what does not take part stays as it is
    for symbol in ("k", "F_v", "F_0"):
        assert centred.value(symbol) == pytest.approx(knows.value(symbol), rel=1.0e-9)
        assert centred.std_error(symbol) == pytest.approx(knows.std_error(symbol), rel=1.0e-3)


def test_ramps_of_two_rates_tell_a_dead_time_from_friction() -> None:
    model, point, knows = at_best(SLIDING)
    centred = about_middle_dead_time(knows, model, point, 1.0)
    for symbol in ("F_c", "F_s"):
        assert centred.value(symbol) == pytest.approx(knows.value(symbol), abs=knows.std_error(symbol))
        assert centred.std_error(symbol) < 2.0 * knows.std_error(symbol)


def test_without_a_dead_time_nothing_is_changed() -> None:
    problem, motion = posed(2035)
    model, point = at_truth(problem, random_test(2035))
    knows = known(model, point, ramps_of(motion), noise_factor=1.0)
    assert knows is not None
    assert about_middle_dead_time(knows, model, point, 1.0) is knows


def test_a_command_alone_gives_the_friction_of_jumps_within_its_interval() -> None:
    test = random_test(JUMPING)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert what_is_wrong(estimate, test) == ()
    for symbol in ("F_c", "F_s"):
        entry, truth = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.ci95 is not None, estimate.message
        assert entry.ci95[0] < truth < entry.ci95[1]
        assert entry.ci95[1] - entry.ci95[0] < 0.6 * truth
