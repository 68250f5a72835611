"""A random test as the search meets it: its model, and the point of the true valve in it."""

from __future__ import annotations

from dataclasses import replace

from estimators.base import Outcome
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.model import StemModel
from estimators.likelihood.problem import Problem, pose
from estimators.likelihood.staircase import read_staircase, with_stops
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray
from tests.estimators.random_valves import RandomTest, random_test

_EVENTS = 40_000


def motion_of(test: RandomTest) -> RecordedMotion:
    """Return the motion with its jumps, where it has some, and its stops."""
    motion = read_motion(test.recording, test.nameplate)
    jumps = read_staircase(test.recording, test.nameplate, motion)
    motion = motion if jumps is None else jumps
    assert isinstance(motion, RecordedMotion)
    return with_stops(motion)


def posed(seed: int) -> tuple[Problem, RecordedMotion]:
    """Return the problem of this seed's test and the motion."""
    test = random_test(seed)
    motion, path = motion_of(test), input_path(test.recording, test.nameplate)
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    return problem, motion


def at_truth(problem: Problem, test: RandomTest) -> tuple[StemModel, FloatArray]:
    """Return the problem's model with events enough for the true valve, and its point (p,)."""
    truth = test.truth.by_symbol()
    values = problem.trials[0].values | {name: truth[name] for name in ("m", "k", "F_v", "F_c", "DV", "F_0")}
    values |= {"d": truth["F_s"] / truth["F_c"] - 1.0, "x_0": test.initial.position_m}
    model = replace(problem.model, most_events=_EVENTS)
    return model, model.coordinates.point(values)
