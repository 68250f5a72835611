"""The errors of a measured pressure's lines as unknowns of the fit."""

from __future__ import annotations

import numpy as np

from estimators.base import Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.input_errors import with_input_errors
from estimators.likelihood.inputs.input_path import MeasuredPath, input_path
from estimators.likelihood.problem import pose
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from tests.estimators.random_valves import random_test


def test_every_line_of_a_noisy_pressure_is_unknown_where_it_matters() -> None:
    # 30 ramps, each line with a level and a slope of its own: 40 of these 60 left 13 standard deviations in a jump
    test = random_test(2337)
    motion = read_motion(test.recording, test.nameplate)
    path = input_path(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert isinstance(path, MeasuredPath)
    problem = pose(motion, path)
    assert problem is not None
    truth = test.truth.by_symbol()
    stiction = {"d": truth["F_s"] / truth["F_c"] - 1.0}
    at = problem.model.coordinates.point(problem.trials[0].values | truth | stiction | {"delay_s": 0.0})
    widened = with_input_errors(problem.model, at, path.variations(np.zeros(1)))
    assert len(widened.deviations) >= 60


def test_the_search_is_begun_anew_where_the_errors_of_the_pressure_decide_which_place_is_the_lowest() -> None:
    # 50 ms, a few rows of ringing at each corner: without these errors nine times the mass fits better than the truth
    test = random_test(2467)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    for symbol in ("m", "F_v", "F_c", "F_s"):
        entry, truth = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.value is not None
        assert entry.std_error is not None
        assert abs(entry.value - truth) < 4.0 * entry.std_error < 0.5 * truth
