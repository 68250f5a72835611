"""The errors of a measured pressure's lines as unknowns of the fit."""

from __future__ import annotations

import numpy as np

from estimators.likelihood.input_errors import with_input_errors
from estimators.likelihood.input_path import MeasuredPath, input_path
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
