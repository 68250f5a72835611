"""The simulated stem of the likelihood: many valves in one call, a block at both sides of its mean time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimators.base import Outcome
from estimators.likelihood.compression import compressed
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.model import STEP, StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.problem import pose
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray
from tests.estimators.recordings import recorded


@cache
def posed() -> tuple[StemModel, FloatArray]:
    """The nominal valve at 10 ms, its rows uneven, and the truth's point."""
    test = recorded("nominal", period_s=0.01, noise_m=2.0e-5, seed=1, jitter=0.1)
    motion, path = read_motion(test.recording, test.nameplate), input_path(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    truth = test.truth.by_symbol()
    values = problem.trials[0].values | {name: truth[name] for name in ("m", "k", "F_v", "F_c", "F_0", "DV")}
    values |= {"d": truth["F_s"] / truth["F_c"] - 1.0}
    return problem.model, problem.model.coordinates.point(values)


def test_valves_that_are_simulated_together_move_as_each_alone() -> None:
    model, point = posed()
    points = np.stack([point, point + 0.01 * (np.array(model.coordinates.names) == "F_v"), point])
    points[2, model.coordinates.names.index("k")] = np.log(1.0e-3)
    together, followed = model.simulate_each(points)
    for number, one in enumerate(points):
        alone = model.simulate(one)
        assert bool(followed[number]) == (alone is not None)
        if alone is not None:
            assert together[number] == pytest.approx(alone, abs=0.0)
    assert followed[0]
    assert float(np.abs(together[1] - together[0]).max()) > 1.0e-6


def test_a_block_is_at_the_mean_of_both_sides_of_its_time() -> None:
    model, point = posed()
    small = compressed(model)
    assert small.block_s is not None
    assert bool((small.block_s == 0.0).any())
    assert bool((small.block_s > 0.01).any())
    sides = [replace(small, time_s=small.time_s + way * small.block_s, block_s=None) for way in (-1.0, 1.0)]
    before, after = (side.simulate(point) for side in sides)
    assert before is not None
    assert after is not None
    assert small.simulate(point) == pytest.approx(0.5 * (before + after), rel=1.0e-12, abs=1.0e-15)


def test_a_part_that_begins_anew_starts_at_its_rest() -> None:
    model, point = posed()
    row = model.time_s.size // 2
    held_m = float(model.position_m[row])
    begun = replace(model, restarts=Restarts(np.array([row]), np.array([held_m + 1.0e-5])))
    through, anew = model.simulate(point), begun.simulate(point)
    assert through is not None
    assert anew is not None
    assert anew[:row] == pytest.approx(through[:row], abs=0.0)
    assert anew[row] == pytest.approx(held_m + 1.0e-5, abs=1.0e-12)


def test_slopes_are_those_of_differences_and_one_sided_at_a_bound() -> None:
    model, point = posed()
    slopes = model.slopes(point)
    assert slopes is not None
    number = model.coordinates.names.index("F_v")
    ends = [model.simulate(point + side * STEP * (np.arange(point.size) == number)) for side in (1.0, -1.0)]
    assert ends[0] is not None
    assert ends[1] is not None
    assert slopes[number] == pytest.approx((ends[0] - ends[1]) / (2.0 * STEP) * model.weight, abs=1.0e-4)
    bounded = point.copy()
    stiction = model.coordinates.names.index("d")
    bounded[stiction] = model.coordinates.lower[stiction]
    at_bound, forward = model.slopes(bounded), model.slopes(bounded, one_sided=True)
    assert at_bound is not None
    assert forward is not None
    assert at_bound[stiction] == pytest.approx(forward[stiction], abs=0.0)
