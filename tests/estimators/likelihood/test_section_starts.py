"""Sections of a recording begin in motion: their first speeds have many places, and a cliff at DV."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.base import Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.delay import searched_model
from estimators.likelihood.descent import descend
from estimators.likelihood.hops import hops
from estimators.likelihood.model import StemModel
from estimators.likelihood.search import with_events
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test

# a section that begins in the middle of a ramp; with all unknowns together its first speed would turn backwards
AT_THE_CLIFF = {
    "m": 1.96069, "k": 42358.3, "F_v": 2387.74, "F_c": 717.403, "d": 0.193798, "F_0": 304.979, "DV": 7.98872e-05,
    "x_0": 0.00642965, "x_1": 0.0247268, "v_1": 0.000131256, "delay_s": 6.42699e-06,
}  # fmt: skip
# a stem that turns twice between two rows of 50 ms: every section but the third begins with another swing
OTHER_SWINGS = {
    "m": 7.392, "k": 381200.0, "F_v": 152.1, "F_c": 168.8, "d": 0.003, "F_0": 1988.0, "DV": 0.0003539,
    "x_0": 0.002179, "x_1": 0.00747, "x_2": 0.0194, "x_3": 0.009846, "v_1": 0.02989, "v_2": -0.0004382, "v_3": 0.01257,
    "delay_s": 0.004387,
}  # fmt: skip


def searched(seed: int) -> tuple[StemModel, float]:
    """Return the model that is searched, and the typical speed of the stem."""
    problem, motion = posed(seed)
    model = searched_model(problem, motion.samples.period_s)
    return with_events(model, len(motion.phases.breakaways)), motion.phases.moving_speed


def test_a_first_speed_at_its_cliff_does_not_stop_the_descent_of_all_others() -> None:
    model, _ = searched(2740)
    point = model.coordinates.point(AT_THE_CLIFF)
    assert descend(model, point, most_steps=30).cost < model.cost(point) - 30.0


def test_sections_begin_anew_as_they_were_measured() -> None:
    model, speed = searched(2782)
    point = model.coordinates.point(OTHER_SWINGS)
    others = [model.coordinates.values(other) for other in hops(model, point, speed, jumps=False)]
    first_m = {f"x_{number}": float(model.position_m[row]) for number, row in enumerate(model.section_row)}
    begun = [own for own in others if all(own[name] == pytest.approx(first_m[name]) for name in first_m)]
    assert len(begun) == 1
    assert begun[0]["v_1"] == pytest.approx(0.00196, rel=0.01)
    # and each of them alone, for the others may be right
    for name, at_m in first_m.items():
        assert sum(own[name] == pytest.approx(at_m) != OTHER_SWINGS[name] for own in others) >= 1


@pytest.mark.parametrize("seed", [2740, 2782])
def test_a_recording_of_sections_in_motion_is_fitted(seed: int) -> None:
    test = random_test(seed)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    for symbol, one in estimate.parameters.items():
        if one.value is not None and one.std_error is not None:
            assert abs(one.value - test.truth.by_symbol()[symbol]) < 4.0 * one.std_error, symbol


def test_a_section_begins_with_its_speed_where_a_jump_ends_within_its_first_rows() -> None:
    # three rows of a jump that was seen as no motion: begun at rest the first two were 33 and 19 deviations off
    problem, _motion = posed(6216)
    model, truth = at_truth(problem, random_test(6216))
    assert "v_1" in model.coordinates.names
    assert "v_0" not in model.coordinates.names
    near = descend(model, truth, most_steps=20)
    residual = model.residuals(near.point)
    assert residual is not None
    row = int(model.section_row[1])
    assert float(np.abs(residual[row : row + 3]).max()) < 4.0
