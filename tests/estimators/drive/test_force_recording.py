"""Drives without a spring, force measured: m, F_v, F_c and F_0 with intervals that hold, F_s only where it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from estimators.base import Estimate, Outcome, Status
from estimators.drive.equation import COLUMNS, window
from estimators.drive.recording import estimate_force_recording
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from tests.estimators.drive.force_axes import NAMEPLATE, Axis, Reference, random_axis
from valve.motion import simulate_motion
from valve.parameters import ValveParameters
from valve.recording import Recording

SLOW = ValveParameters(20.0, 0.0, 400.0, 20.0, 26.0, 1.0e-5, -3.0)


def estimated(recording: Recording) -> Estimate:
    return estimate_force_recording(recording, NAMEPLATE)


def ramped(noise_m: float, seed: int = 1, spring_n_per_m: float = 0.0) -> Recording:
    """SLOW under ramps of force, so slow that it rests at every turn and breaks away."""
    corner_s = np.array([0.0, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0, 16.0])
    corner_n = np.array([0.0, 70.0, -70.0, 70.0, -70.0, 60.0, -60.0, 60.0, -60.0, 0.0]) - 3.0
    time_s, random = np.arange(16001, dtype=np.float64) * 1.0e-3, np.random.default_rng(seed)
    truth = replace(SLOW, spring_rate_n_per_m=spring_n_per_m)
    position_m = simulate_motion(truth, corner_s, corner_n, time_s).position_m
    force_n = np.interp(time_s, corner_s, corner_n) + 0.02 * random.standard_normal(time_s.size)
    return Recording(
        time_s=time_s, position_m=position_m + noise_m * random.standard_normal(time_s.size), force_n=force_n
    )


def deviations(axis: Axis, estimate: Estimate) -> list[float]:
    """Errors of (m, F_v, F_c, F_0) in standard errors."""
    raw, error = estimate.diagnostics["raw"], estimate.diagnostics["std_error"]
    return [(raw[symbol] - axis.value(symbol)) / error[symbol] for symbol in COLUMNS]


@pytest.mark.parametrize("reference", list(Reference))
def test_without_noise_an_axis_is_recovered(reference: Reference) -> None:
    axis = random_axis(1, reference=reference, noise_m=0.0, force_noise=0.0)
    estimate = estimated(axis.recording)
    assert estimate.status is Status.OK
    assert estimate.residual_rms_m is None
    for symbol in COLUMNS:
        assert estimate.value(symbol) == pytest.approx(axis.value(symbol), rel=5.0e-4), symbol


def test_ninety_five_percent_intervals_hold_the_truth_about_that_often() -> None:
    axes = [random_axis(seed, duration_s=6.0) for seed in range(500, 530)]
    scaled = np.array([deviations(axis, estimated(axis.recording)) for axis in axes])
    # 120 values: 250 axes of 12 s gave 94 to 98 %
    assert (np.abs(scaled) < 1.96).mean() > 0.88
    assert 0.6 < float(np.sqrt(np.mean(np.clip(scaled, -4.0, 4.0) ** 2))) < 1.3


def test_random_axes_are_not_called_poor_for_a_spring_that_is_not_there() -> None:
    for seed in range(12):
        estimate = estimated(random_axis(seed, duration_s=6.0).recording)
        assert "spring" not in estimate.message, seed


@pytest.mark.parametrize("noise_m", [20.0e-6, 100.0e-6])
def test_position_noise_that_the_controller_answers_to_biases_nothing(noise_m: float) -> None:
    axes = [
        random_axis(seed, reference=Reference.SINE, noise_m=noise_m, force_noise=0.01, correlation=0.0, duration_s=8.0)
        for seed in range(9)
    ]
    mean = np.mean([deviations(axis, estimated(axis.recording)) for axis in axes], axis=0)
    # the mean of 9 scatters by 0.33
    assert np.abs(mean).max() < 1.0


def test_more_position_noise_gets_a_longer_window() -> None:
    windows = [
        estimated(random_axis(3, noise_m=noise_m, force_noise=0.01).recording).diagnostics["window_s"]
        for noise_m in (1.0e-7, 1.0e-5, 1.0e-4)
    ]
    assert windows[0] < windows[1] < windows[2]


@pytest.mark.parametrize("noise_m", [0.0, 2.0e-6])
def test_static_friction_comes_from_slow_breakaways(noise_m: float) -> None:
    static = estimated(ramped(noise_m)).parameters["F_s"]
    assert static.ci95 is not None
    assert static.ci95[0] < 26.0 < static.ci95[1]
    assert static.ci95[1] - static.ci95[0] < 4.0


def test_static_friction_is_absent_where_noise_hides_the_instants() -> None:
    static = estimated(ramped(1.0e-4)).parameters["F_s"]
    assert static.value is None
    assert "too fast" in static.note


def test_rests_are_left_out_and_bias_nothing() -> None:
    estimate = estimated(ramped(2.0e-6))
    assert estimate.status is Status.OK
    assert estimate.diagnostics["rows_at_rest"] > 1000
    assert estimate.value("F_c") == pytest.approx(20.0, rel=1.0e-3)
    assert estimate.value("F_v") == pytest.approx(400.0, rel=1.0e-3)


def test_the_mirrored_axis_has_the_opposite_preload_and_the_rest_alike() -> None:
    recording = random_axis(7).recording
    assert recording.force_n is not None
    mirrored = replace(recording, position_m=-recording.position_m, force_n=-recording.force_n)
    one, other = estimated(recording), estimated(mirrored)
    for symbol in ("m", "F_v", "F_c"):
        assert other.value(symbol) == pytest.approx(one.value(symbol), rel=1.0e-6), symbol
    assert other.diagnostics["raw"]["F_0"] == pytest.approx(-one.diagnostics["raw"]["F_0"], rel=1.0e-6)


def test_the_preload_has_the_sign_of_the_model() -> None:
    # m x'' = F - k x - F_0 - friction: at rest without friction the actuator pushes with F = F_0
    assert estimated(ramped(2.0e-6)).value("F_0") == pytest.approx(-3.0, abs=0.01)


def test_gaps_and_jitter_are_borne() -> None:
    axis = random_axis(11, noise_m=1.0e-6, force_noise=0.01, correlation=0.0)
    random = np.random.default_rng(5)
    recording = axis.recording
    time_s = recording.time_s.copy()
    time_s[1:-1] += random.uniform(-2.0e-4, 2.0e-4, time_s.size - 2)
    force_n = np.interp(time_s, recording.time_s, np.asarray(recording.force_n))
    position_m = CubicSpline(recording.time_s, recording.position_m)(time_s)
    position_m[3000:3100] = np.nan
    estimate = estimated(Recording(time_s=time_s, position_m=position_m, force_n=force_n))
    assert estimate.status is Status.OK
    for symbol in ("m", "F_v", "F_c"):
        assert estimate.value(symbol) == pytest.approx(axis.value(symbol), rel=0.02), symbol


def test_slow_sampling_widens_the_intervals_enough() -> None:
    axes = [random_axis(seed) for seed in range(12)]
    sampled = [estimated(axis.recording.rows(slice(None, None, 20))) for axis in axes]
    told = [deviations(axis, estimate) for axis, estimate in zip(axes, sampled, strict=True) if estimate.status == "ok"]
    assert len(told) >= 4
    assert (np.abs(told) < 1.96).mean() > 0.85


def test_a_spring_that_the_nameplate_denies_makes_the_estimate_poor() -> None:
    estimate = estimated(ramped(2.0e-6, spring_n_per_m=40.0))
    assert estimate.status is Status.POOR
    assert "check the nameplate's action" in estimate.message


def spotted(axis: Axis, share: float) -> Recording:
    """The axis's recording with a tight spot of ``share`` of F_c that its force overcame: the motion is the same."""
    recording = axis.recording
    middle_m, range_m = float(np.median(recording.position_m)), float(np.ptp(recording.position_m))
    sense = np.sign(np.gradient(uniform_filter1d(recording.position_m, 25)))
    spot_n = share * axis.value("F_c") * np.exp(-0.5 * ((recording.position_m - middle_m) / (0.03 * range_m)) ** 2)
    return replace(recording, force_n=np.asarray(recording.force_n) + sense * spot_n)


@pytest.mark.parametrize("seed", [3, 6, 8])
def test_intervals_hold_the_truth_where_the_misfit_is_locked_to_the_motion(seed: int) -> None:
    # F_v was 4.6 to 5.9 standard errors off, F_c 2.8 to 3.6
    axis = random_axis(seed, reference=Reference.SINE, noise_m=5.0e-6, force_noise=0.01)
    assert np.abs(deviations(axis, estimated(spotted(axis, 0.5)))).max() < 2.0


@pytest.mark.parametrize("seed", [4, 5])
def test_a_misfit_at_the_same_places_on_every_stroke_withholds_mass_and_damping(seed: int) -> None:
    axis = random_axis(seed, reference=Reference.SINE, noise_m=5.0e-6, force_noise=0.01)
    assert estimated(axis.recording).status is Status.OK
    estimate = estimated(spotted(axis, 0.5))
    assert estimate.status is Status.POOR
    assert "at the same places on every stroke" in estimate.message
    assert estimate.value("m") is None
    assert estimate.value("F_v") is None
    assert estimate.value("F_c") is not None


def test_noise_is_never_foretold_from_stroke_to_stroke() -> None:
    for seed in range(12):
        assert estimated(random_axis(seed, duration_s=8.0).recording).diagnostics["share_at_places"] < 0.1, seed


def test_one_direction_leaves_coulomb_friction_and_preload_tied() -> None:
    whole = ramped(2.0e-6)
    moving = whole.rows((whole.time_s > 0.55) & (whole.time_s < 1.7))
    estimate = estimated(moving)
    assert estimate.status is Status.POOR
    assert str(Outcome.ONE_DIRECTION_ONLY) in estimate.message
    assert estimate.value("F_v") == pytest.approx(400.0, rel=0.02)
    for symbol in ("F_c", "F_s", "F_0"):
        assert estimate.value(symbol) is None
    assert "is known to" in estimate.parameters["F_c"].note


@pytest.mark.parametrize(
    ("recording", "outcome"),
    [
        (ramped(1.0e-6).rows(slice(0, 200)), Outcome.NEVER_MOVED),
        (ramped(1.0e-6).rows(slice(0, 30)), Outcome.TOO_FEW_SAMPLES),
        (replace(ramped(1.0e-6), force_n=np.full(16001, 5.0)), Outcome.NO_FORCE_CHANGE),
    ],
    ids=["never moved", "too few", "constant force"],
)
def test_what_tells_nothing_has_a_name(recording: Recording, outcome: Outcome) -> None:
    estimate = estimated(recording)
    assert estimate.status is Status.FAILED
    assert estimate.message == str(outcome)


def test_a_drive_that_runs_against_its_force_is_unphysical() -> None:
    recording = random_axis(7).recording
    assert recording.force_n is not None
    assert estimated(replace(recording, force_n=-recording.force_n)).message == str(Outcome.UNPHYSICAL)


def test_maximum_likelihood_takes_such_recordings_here() -> None:
    recording = random_axis(7).recording
    assert MaximumLikelihoodEstimator().estimate(recording, NAMEPLATE).to_json() == estimated(recording).to_json()


@pytest.mark.parametrize("half_width", [2, 7, 40])
def test_kernels_are_exact_for_steady_acceleration(half_width: int) -> None:
    used = window(half_width, 1.0e-3)
    time_s = 1.0e-3 * np.arange(-used.reach, used.reach + 1, dtype=np.float64)
    position_m = 0.3 + 0.2 * time_s + 1.5 * time_s**2
    assert used.acceleration @ position_m == pytest.approx(3.0, rel=1.0e-8)
    assert used.velocity[::-1] @ position_m == pytest.approx(0.2, rel=1.0e-8)
    assert used.force.sum() == pytest.approx(1.0)
    assert used.sense.sum() == pytest.approx(1.0)
