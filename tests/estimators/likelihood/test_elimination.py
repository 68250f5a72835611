"""The errors of a measured input, eliminated about those that were found: what a search sees and what it concludes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from estimators.base import Outcome, Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.all_rows import certified
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.doubts import doubt_of
from estimators.likelihood.elimination import eliminated
from estimators.likelihood.hopping import Hopping
from estimators.likelihood.input_errors import hopped_anew, with_input_errors
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.lines import stretches
from estimators.likelihood.model import StemModel
from estimators.likelihood.ramps import ramps_of
from estimators.likelihood.search import Found, with_events
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

pytestmark = pytest.mark.long


def widened(seed: int) -> tuple[StemModel, FloatArray, RecordedMotion]:
    """Return the model with the input's errors as unknowns, its point at the truth without errors, and the motion."""
    test = random_test(seed)
    problem, motion = posed(seed)
    model, point = at_truth(problem, test)
    model = with_events(replace(model, most_events=problem.model.most_events), len(motion.phases.breakaways))
    path = input_path(test.recording, test.nameplate)
    assert not isinstance(path, Outcome)
    wide = with_input_errors(model, point, path.variations(np.zeros(len(path.nuisances))))
    return wide, np.concatenate([point, np.zeros(len(wide.deviations))]), motion


def test_errors_of_many_sigmas_are_eliminated_as_if_each_place_had_its_own() -> None:
    model, point, _ = widened(2577)
    count = point.size - len(model.deviations)
    point[count : count + 2] = 4.0, -3.0
    small = compressed(model)
    simulated_m = small.simulate(point)
    assert simulated_m is not None
    small = replace(small, position_m=simulated_m)
    near = eliminated(small, point)
    assert near is not None
    assert near.count == count
    for name, more in (("F_c", 1.0e-3), ("d", 1.0e-3)):
        other = point.copy()
        other[small.coordinates.names.index(name)] += more
        own = other[:count]
        best = descend(small, other, most_steps=20, held=small.coordinates.names[:count]).cost
        assert near.model.cost(own) == pytest.approx(best, abs=0.3)
        assert small.cost(near.with_errors(own)) == pytest.approx(best, abs=0.3)
        assert best < small.cost(other) - 0.3


def test_a_fit_at_a_wrong_dv_is_hopped_from_once_the_errors_of_the_input_are_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # blocks chosen without these errors, and errors eliminated about another place, led to 14 times the DV
    monkeypatch.setattr("estimators.likelihood.input_errors._MOST_ROUNDS", 1)
    model, truth, motion = widened(2561)
    wrong = {"m": 2.734, "F_v": 670.0, "F_c": 76.346, "d": 0.00466, "DV": 1.3e-4}
    at = model.coordinates.values(truth)
    begun = model.coordinates.point(at | wrong)
    fitted = descend(compressed(model), begun, most_steps=12, one_sided=True)
    point, cost = fitted.point, model.cost(fitted.point)
    found = Found(model, point, cost, certified(model, point), (), 1.0, 0, 0, 0.0)
    assert model.coordinates.values(point)["DV"] > 8.0 * at["DV"]
    hopping = Hopping(motion.phases.moving_speed, False, min(ramps_of(motion).rates_n_per_s))
    ended = hopped_anew(found, hopping)
    assert ended.cost < cost - 100.0
    assert model.coordinates.values(ended.point)["DV"] < 3.0 * at["DV"]


def test_a_fit_at_the_bottom_that_strains_its_input_is_doubted_for_that() -> None:
    doubt = partial(doubt_of, is_bottom=True, is_spring_open=False, hides=False, is_confirmed=True, is_too_heavy=False)
    assert "another force than was measured" in doubt(strain=6.6)
    assert doubt(strain=6.4) == ""


def test_friction_is_withheld_where_the_position_asks_for_a_force_that_was_not_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 50 ms behind an I/P of 60 ms: with sharp corners an error of the lines 10 times their noise, and an F_s that is 10
    # standard errors off
    for lines in ("lagged_lines", "lines_behind_some_lag"):
        monkeypatch.setattr(stretches, lines, lambda *_rows: None)
    test = random_test(2578)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.POOR
    assert estimate.diagnostics["strain_of_input"] > 6.5
    # the fit may end before the bottom of its cost as well, which is told first
    assert "another force than was measured" in estimate.message or "bottom of its cost" in estimate.message
    for symbol in ("m", "F_v", "F_c", "F_s", "DV"):
        assert estimate.value(symbol) is None
    for symbol in ("k", "F_0"):
        entry, true = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.value is not None
        assert entry.std_error is not None
        assert abs(entry.value - true) < 4.0 * entry.std_error
    # behind its lag the force is the measured one
    monkeypatch.undo()
    test = random_test(2578)
    assert ExactMotionEstimator().estimate(test.recording, test.nameplate).diagnostics["strain_of_input"] < 4.0
