"""A sensor whose steps are larger than its noise: rounding repeats its error while the stem stays on one step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.inputs.input_path import MeasuredPath, input_path
from estimators.likelihood.problem import pose
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from tests.estimators.likelihood.polled_recordings import converted
from tests.estimators.recordings import Recorded, paper_triangle, recorded
from valve.parameter_sets import parameter_set

pytestmark = pytest.mark.long


def on_converters(valve: str, noise_m: float, bits: int, seed: int = 11) -> Recorded:
    """A captured test with steps of the position's sensor and 16 bits of pressure."""
    plate = parameter_set(valve).nameplate
    assert plate.signal is not None
    step_m = 1.1 * plate.actuator.travel_m / (2**bits - 2)
    test = recorded(valve, noise_m=noise_m, seed=seed, resolution_m=step_m, waveform=paper_triangle(valve, 2))
    assert test.recording.pressure_pa is not None
    low_pa, high_pa = plate.signal.range_pa
    margin_pa = 0.05 * (high_pa - low_pa)
    rounded_pa = converted(test.recording.pressure_pa, low_pa - margin_pa, high_pa + margin_pa)
    return Recorded(replace(test.recording, pressure_pa=rounded_pa), test.nameplate, test.truth)


def weights(test: Recorded) -> tuple[np.ndarray, float]:
    """Weights of the rows times the noise, shape (n,), and the noise, m."""
    motion = read_motion(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    path = input_path(test.recording, test.nameplate)
    assert isinstance(path, MeasuredPath)
    problem = pose(motion, path)
    assert problem is not None
    return problem.model.weight * problem.noise_m, problem.noise_m


def test_a_pressure_on_a_converters_steps_is_its_ramps_and_not_the_steps() -> None:
    test = on_converters("nominal", 0.3e-6, 16)
    path = input_path(test.recording, test.nameplate)
    assert isinstance(path, MeasuredPath)
    time_s, force_n = path.corners(np.zeros(1))
    assert time_s.size <= 8
    span_n = float(np.ptp(test.recording.actuator_force_n(test.nameplate)))
    # without the corners that a delay may ask for, beyond the rows
    assert float(np.ptp(force_n[1:-1])) == pytest.approx(span_n, rel=1.0e-4)


def test_a_rest_on_one_step_tells_of_its_level_once() -> None:
    share, noise_m = weights(on_converters("rough", 0.3e-6, 12))
    step_m = 1.1 * 0.1016 / 4094
    assert noise_m == pytest.approx(step_m / np.sqrt(12.0), rel=0.2)
    assert share.max() <= 1.0
    # rests of seconds at 1 kHz
    assert share.min() < 1.0 / np.sqrt(1000.0)
    assert float(share @ share) < 0.35 * share.size


def test_a_row_of_a_rest_has_no_weight_of_its_own_noise() -> None:
    # noise of half a step: rows that lay a step off kept a whole weight, and drew the rest's level by 1 um
    test = on_converters("nominal", 12.0e-6, 12)
    share, _ = weights(test)
    still_m = recorded("nominal", noise_m=0.0, waveform=paper_triangle("nominal", 2)).recording.position_m
    levels_m, rest, rows = np.unique(np.round(still_m, 9), return_inverse=True, return_counts=True)
    long = np.flatnonzero(rows > 1000)
    assert long.size >= 2
    for number in long:
        own = share[rest == number]
        assert np.median(own) < 0.95, levels_m[number]
        assert np.mean(np.abs(own / np.median(own) - 1.0) > 1.0e-3) < 0.01, levels_m[number]


def test_noise_that_shakes_the_sensor_through_its_steps_makes_every_row_count() -> None:
    share, _ = weights(on_converters("rough", 5.0e-6, 16))
    assert share == pytest.approx(1.0)


@pytest.mark.parametrize(("valve", "bits", "wanted"), [("nominal", 16, 0.3), ("rough", 16, 2.0), ("nominal", 12, 5.0)])
def test_maximum_likelihood_is_right_on_a_coarse_and_quiet_sensor(valve: str, bits: int, wanted: float) -> None:
    test = on_converters(valve, 0.3e-6, bits)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    truth = test.truth.by_symbol()
    for symbol in ("m", "k", "F_v", "F_c", "F_s"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None
        assert abs(entry.value - truth[symbol]) < 3.0 * entry.std_error, symbol
    assert estimate.parameters["m"].value == pytest.approx(truth["m"], rel=0.01 * wanted)
