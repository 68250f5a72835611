"""Blocks of rows tell the search what all rows tell, and rests are told from creeping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.block_kernel import straight_blocks
from estimators.likelihood.certificate import certify
from estimators.likelihood.compression import compressed
from estimators.likelihood.delay import searched_model
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.model import StemModel
from estimators.likelihood.problem import pose
from estimators.likelihood.staircase import find_rests
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray, IntArray, Samples, prepare
from tests.estimators.recordings import recorded


def blocks_of(position_m: FloatArray, noise_m: float) -> IntArray:
    time_s = np.arange(position_m.size, dtype=np.float64)
    weight = np.full(position_m.size, 1.0 / noise_m)
    return np.asarray(np.diff(straight_blocks(time_s, position_m, weight, np.empty(0, np.int64), 9.0, 256)))


def samples_of(noise_m: float) -> Samples:
    test = recorded("nominal", noise_m=noise_m, seed=5)
    samples = prepare(test.recording, test.nameplate)
    assert isinstance(samples, Samples)
    return samples


def test_a_rest_becomes_few_blocks_and_a_jump_keeps_its_rows() -> None:
    random = np.random.default_rng(1)
    position_m = np.concatenate([np.zeros(1000), [0.3e-3, 0.7e-3], np.full(1000, 1.0e-3)])
    rows = blocks_of(position_m + 1.0e-6 * random.standard_normal(position_m.size), 1.0e-6)
    assert rows.sum() == position_m.size
    assert rows.size < 200
    edges = np.cumsum(rows)
    assert {1000, 1001, 1002} <= set(edges.tolist())


def test_a_slow_ramp_under_noise_is_no_staircase() -> None:
    samples = samples_of(noise_m=20.0e-6)
    rests = find_rests(samples)
    assert rests is None or rests.level_m.size < 40


def test_brief_jumps_between_rests_are_found_with_the_noise_at_rest() -> None:
    samples = samples_of(noise_m=2.0e-6)
    random = np.random.default_rng(2)
    level_m = 1.0e-4 * (np.arange(samples.count) // 25)
    stairs = replace(samples, position_m=level_m + 2.0e-6 * random.standard_normal(samples.count))
    rests = find_rests(stairs)
    assert rests is not None
    assert rests.level_m.size > 0.9 * samples.count / 25
    assert 1.8e-6 < rests.noise_m < 2.2e-6


def test_a_misfit_in_transients_alone_spoils_the_certificate() -> None:
    random = np.random.default_rng(3)
    residual, bends = random.standard_normal(20_000), np.zeros(20_000, dtype=np.bool_)
    bends[::50] = True
    weight = np.ones(20_000)
    assert certify(residual, weight, bends).is_good
    assert not certify(np.where(bends, 1.8 * residual, residual), weight, bends).is_good


def error_of_mass(model: StemModel, point: FloatArray) -> float:
    slopes = model.slopes(point)
    assert slopes is not None
    covariance = np.linalg.inv(slopes @ slopes.T + np.diag(model.coordinates.prior_weight))
    return float(np.sqrt(covariance[0, 0]))


def test_blocks_that_keep_a_point_tell_what_all_rows_tell_there() -> None:
    # m/F_v is two rows long: the noise hides each bend, and all of them together show the mass
    test = recorded("vendor", noise_m=20.0e-6, seed=8)
    motion, path = read_motion(test.recording, test.nameplate), input_path(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert not isinstance(path, Outcome)
    problem = pose(motion, path)
    assert problem is not None
    model = searched_model(problem, motion.samples.period_s)
    truth = test.truth.by_symbol()
    values = problem.trials[0].values | {name: truth[name] for name in ("m", "k", "F_v", "F_c", "F_0", "DV")}
    point = model.coordinates.point(values | {"d": 0.05})
    told = error_of_mass(model, point)
    assert error_of_mass(compressed(model), point) > 1.2 * told
    kept = compressed(model, keeping=point)
    assert error_of_mass(kept, point) < 1.02 * told
    assert kept.time_s.size < 0.05 * model.time_s.size
