"""Polled tests on an I/P without lag: the stem moves by the steps of its writes, whose instants are recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.compression import compressed
from estimators.likelihood.inputs.command_steps import written_steps
from estimators.likelihood.inputs.commanded_path import CommandedPath
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.inputs.row_timing import look_doubts_s, position_doubts, shared_by_rest, write_doubts_s
from estimators.likelihood.problem import pose
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import resolution
from tests.estimators.likelihood.polled_recordings import WrittenTest, written_test
from valve.recording import Acquisition, Recording

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def nominal() -> WrittenTest:
    return written_test("nominal", seed=2)


def path_of(test: WrittenTest, recording: Recording | None = None) -> CommandedPath:
    path = input_path(recording or test.recording, test.nameplate)
    assert isinstance(path, CommandedPath)
    return path


def test_a_step_is_placed_within_its_writes_exchange(nominal: WrittenTest) -> None:
    path = path_of(nominal)
    assert path.is_stepped
    off_s = path.step_s - nominal.acting_s
    assert np.abs(off_s / path.write_doubt_s).max() < np.sqrt(3.0)  # the ends of a uniform distribution
    assert float(np.median(np.abs(off_s))) < 0.05e-3
    # without the record of the writes
    silent = replace(nominal.recording, write_sent_s=None, written_s=None)
    blind = path_of(nominal, silent)
    assert (blind.write_doubt_s == 0.0).all()
    assert float(np.sum((blind.step_s - nominal.acting_s) ** 2)) > 1.2 * float(np.sum(off_s**2))


def test_a_row_that_wrote_nothing_has_the_doubt_of_the_write_before_it() -> None:
    time_s = np.arange(4.0)
    nan = np.nan
    recording = Recording(
        time_s,
        time_s,
        command_pa=np.array([1.0, 1.0, 2.0, 2.0]),
        sent_s=time_s - 0.1,
        received_s=time_s + 0.1,
        write_sent_s=np.array([nan, -0.5, 1.5, nan]) + 0.0,
        written_s=np.array([nan, -0.2, 1.9, nan]),
    )
    rows = np.arange(4)
    assert write_doubts_s(recording, rows) * np.sqrt(12.0) == pytest.approx([0.0, 0.3, 0.4, 0.4])
    assert look_doubts_s(recording, rows) * np.sqrt(12.0) == pytest.approx(0.2)


def test_a_rest_keeps_the_doubt_of_the_writes_before_it_once() -> None:
    time_s = np.arange(20.0)
    position_m = np.minimum(np.maximum(time_s - 4.0, 0.0), 6.0)  # at rest, in motion, at rest
    recording = Recording(
        time_s,
        position_m,
        command_pa=time_s,
        sent_s=time_s - 0.1,
        received_s=time_s + 0.1,
        write_sent_s=time_s - 0.5,
        written_s=time_s - 0.5 + np.where(time_s == 9.0, 0.4, 0.2),
    )
    doubts = position_doubts(recording, time_s, position_m, 1.0e-3)
    write_s, late_s, look_s = np.array([0.2, 0.4, 0.2]) / np.sqrt(12.0)
    assert doubts.total_m[:4] == pytest.approx(0.0)
    assert doubts.total_m[6] == pytest.approx(np.hypot(write_s, look_s))
    assert doubts.lasting_m[13:] == pytest.approx(late_s)  # of the longest of the last three writes in motion
    still = np.arange(20) >= 13
    share = shared_by_rest(still, doubts.total_m, doubts.lasting_m)
    assert share[:13] == pytest.approx(1.0)
    assert float((share[13:] ** 2).sum()) == pytest.approx(1.0)  # seven rows tell what one does
    silent = replace(recording, sent_s=None, received_s=None, write_sent_s=None, written_s=None)
    assert (position_doubts(silent, time_s, position_m, 1.0e-3).total_m == 0.0).all()


def test_moving_rows_of_a_staircase_are_not_joined_to_blocks(nominal: WrittenTest) -> None:
    motion = read_motion(nominal.recording, nominal.nameplate)
    assert isinstance(motion, RecordedMotion)
    problem = pose(motion, path_of(nominal))
    assert problem is not None
    assert problem.model.stepped
    small, joined = compressed(problem.model), compressed(replace(problem.model, stepped=False))
    moving = np.abs(np.diff(problem.model.position_m)) > 20.0e-6
    assert joined.time_s.size < 0.5 * moving.sum() < small.time_s.size < problem.model.time_s.size
    nearest = np.abs(problem.model.time_s[1:][moving][:, None] - small.time_s[None, :]).min(axis=1)
    assert nearest.max() < 1.0e-9


@pytest.mark.parametrize(("valve", "seed"), [("nominal", 2), ("rough", 13)])
def test_maximum_likelihood_finds_the_valve_of_a_polled_test_without_lag(valve: str, seed: int) -> None:
    test = written_test(valve, seed)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    truth = test.truth.by_symbol()
    for symbol, percent in (("k", 0.02), ("F_v", 4.0), ("F_c", 0.05), ("F_s", 0.2)):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None
        assert abs(entry.value - truth[symbol]) < 3.0 * entry.std_error, symbol
        assert entry.value == pytest.approx(truth[symbol], rel=0.01 * percent), symbol
    mass = estimate.parameters["m"]
    assert mass.value is None or abs(mass.value - truth["m"]) < 3.0 * (mass.std_error or 0.0)


def test_a_grid_is_found_through_single_precision() -> None:
    step = 1.7053742846455576e-06
    values = (step * np.random.default_rng(1).integers(-3000, 60000, 5000)).astype(np.float32).astype(np.float64)
    values = np.concatenate([values[:1], values[:1] + step, values]).astype(np.float32).astype(np.float64)
    assert resolution(values) == pytest.approx(step, rel=1.0e-4)
    assert resolution(np.random.default_rng(1).normal(size=5000)) == 0.0


def test_no_steps_are_read_of_a_recording_that_was_not_polled(nominal: WrittenTest) -> None:
    recording = nominal.recording
    assert recording.command_pa is not None
    captured = replace(recording, provenance=replace(recording.provenance, acquisition=Acquisition.CAPTURED))
    assert written_steps(captured, recording.command_pa) is None
