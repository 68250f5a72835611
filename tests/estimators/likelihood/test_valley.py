"""A stem that sticks and slips leaves a narrow, bent valley: it is walked along, and its length is in the intervals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimators.base import Outcome
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates, linear, logarithmic
from estimators.likelihood.descent import descend
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.intervals import flat_errors
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.problem import pose
from estimators.likelihood.valley import STRAIGHT, led_down, walk
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import BoolArray, FloatArray
from tests.estimators.likelihood.computed_model import ComputedModel
from tests.estimators.random_valves import random_test


@cache
def jumping() -> tuple[StemModel, FloatArray]:
    """A sine of 66 s under which the stem jumps 18 times, and the truth's point."""
    test = random_test(113)
    motion = read_motion(test.recording, test.nameplate)
    path = input_path(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    truth = test.truth.by_symbol()
    values = problem.trials[0].values | {name: truth[name] for name in ("m", "k", "F_v", "F_c", "F_0", "DV")}
    values |= {"d": truth["F_s"] / truth["F_c"] - 1.0, "x_0": test.initial.position_m}
    return problem.model, problem.model.coordinates.point(values)


def test_what_lies_up_the_valley_is_led_down_to_its_bottom() -> None:
    model, truth = jumping()
    small = compressed(model)
    found = descend(small, truth, most_steps=20, one_sided=True)
    bottom = led_down(small, Place(found.point, found.cost), STRAIGHT, Budget.limited(2.0e6), 0.0)
    assert bottom.cost <= found.cost
    walked = walk(small, bottom, "F_v", 1, budget=Budget.limited(2.0e6), largest_rise=30.0)
    rises = [place.cost - bottom.cost for place in walked.places]
    assert rises[-1] > 30.0 > max(rises[:-1])
    number = small.coordinates.names.index("F_v")
    alone = bottom.point.copy()
    alone[number] = walked.places[-1].point[number]
    assert small.cost(alone) > 10.0 * walked.places[-1].cost
    back = led_down(small, walked.places[-1], STRAIGHT, Budget.limited(2.0e6), 0.0)
    assert back.cost == pytest.approx(bottom.cost, abs=1.0)
    assert back.point[number] == pytest.approx(bottom.point[number], abs=0.02)


class _Held:
    """A force that stays."""

    def corners(self, _values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.array([0.0, 1.0]), np.zeros(2)


class _Banana(ComputedModel):
    """Residuals of which m and F_v are known together, along a bend, and m alone by a tenth of a standard deviation."""

    def simulate_each(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        m, viscous = points[:, 0], points[:, 2]
        simulated_m = np.stack([0.1 * m, 1000.0 * (viscous - m * m), *points[:, [1, 3, 4, 5, 6]].T], axis=1)
        return simulated_m, np.ones(m.size, dtype=np.bool_)


def banana() -> StemModel:
    names = ("m", "k", "F_v", "F_c", "d", "F_0", "DV")
    coordinates = Coordinates(
        tuple(linear(name, 1.0) if name in {"d", "F_0"} else logarithmic(name, 1.0e-4, 1.0e4) for name in names)
    )
    rows = np.arange(7.0)
    return _Banana(
        time_s=rows,
        position_m=np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]),
        weight=np.ones(7),
        path=_Held(),
        coordinates=coordinates,
        section_row=np.zeros(1, dtype=np.int64),
        input_names=(),
        range_m=1.0,
    )


def test_a_walk_follows_a_bend_that_a_straight_step_leaves() -> None:
    model = banana()
    start = Place(model.position_m[[0, 2, 1, 3, 4, 5, 6]], 0.0)
    walked = walk(model, start, "m", 1, budget=Budget.limited(1.0e6))
    far = walked.places[-1].point
    assert far[0] > 2.0
    assert far[2] == pytest.approx(far[0] ** 2, abs=1.0e-2)
    assert walked.places[-1].cost < 1.0


def test_the_intervals_reach_along_the_whole_bend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimators.likelihood.intervals.compressed", lambda model, **_: model)
    model = banana()
    start = model.position_m[[0, 2, 1, 3, 4, 5, 6]]
    least = flat_errors(model, start, noise_factor=1.0, jumps=False).least
    # ln m is free by 2.3 either way before the walk ends: a factor of 10
    assert least["m"] * 1.96 > 7.0
    assert least["F_v"] * 1.96 > 7.0


def test_without_walks_the_bend_is_missed() -> None:
    """The information at the point alone calls F_v known where the bend begins: what the walks are for."""
    model = banana()
    slopes = model.slopes(np.zeros(7) + np.array([0, 0, 0, 0, 1.0, 0, 0]))
    assert slopes is not None
    covariance = np.linalg.inv(slopes @ slopes.T)
    assert np.sqrt(covariance[2, 2]) < 0.01


def test_a_block_is_the_mean_of_its_rows_where_the_motion_bends_too() -> None:
    model, truth = jumping()
    exact = model.simulate(truth)
    assert exact is not None
    shifted = replace(model, position_m=exact)
    small = compressed(shifted)
    assert small.time_s.size < 0.1 * model.time_s.size
    assert small.cost(truth) - small.prior_cost(truth) < 5.0
