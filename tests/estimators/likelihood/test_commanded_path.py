"""The force of a polled test: its commands' staircase behind the I/P, fitted to the measured pressure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from estimators.likelihood.inputs.commanded_path import CommandedPath
from estimators.likelihood.inputs.input_path import InputPath, MeasuredPath, TransducerPath, input_path
from estimators.likelihood.inputs.pressure_lines import measured_path
from estimators.likelihood.inputs.stair_kernel import stair_answer
from estimators.likelihood.inputs.write_instants import lateness_s
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray
from valve.motion import simulate_motion
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Acquisition, Provenance, Recording
from valve.stem import StemState
from valve.waveform import triangle

NOMINAL = PARAMETER_SETS["nominal"]
NAMEPLATE: Nameplate = NOMINAL.nameplate
LOW_PA, HIGH_PA = 10.0e3, 80.0e3
SPAN_PA = HIGH_PA - LOW_PA
AREA_M2 = float(NAMEPLATE.actuator.diaphragm_area_m2 or 0.0)
WAVE = triangle(20.0, 2, LOW_PA, HIGH_PA)
GAIN, OFFSET_PA = 1.002, -60.0
NOISE_PA, NOISE_M = 5.0, 2.0e-6


@dataclass(frozen=True, slots=True)
class PolledTest:
    """What the service would have recorded, and the true force as corners, s and N."""

    recording: Recording
    force_time_s: FloatArray
    force_n: FloatArray


def polled(
    lag_s: float,
    period_s: float,
    *,
    seed: int = 1,
    missed: int = 0,
    dead_time_s: float = 0.0,
    noise_pa: float = NOISE_PA,
    late: float = 0.0,
) -> PolledTest:
    """A write at the start of each slot, which is late by up to 2 ms, and a look 2 ms after it.

    A share ``late`` of the looks are up to 10 ms later: the machine had something else to do.
    """
    random = np.random.default_rng(seed)
    begun_s = np.arange(round(WAVE.duration_s / period_s), dtype=np.float64) * period_s
    begun_s += random.uniform(0.0, 2.0e-3, begun_s.size)
    if missed:
        begun_s = np.delete(begun_s, random.choice(np.arange(10, begun_s.size), missed, replace=False))
    command_pa = WAVE.at(begun_s)
    written_s, sent_s = begun_s + 0.3e-3, begun_s + 2.0e-3
    is_late = random.random(begun_s.size) < late
    sent_s = sent_s + np.where(is_late, random.uniform(0.0, 0.01, begun_s.size), 0.0) if late else sent_s
    time_s = sent_s + 0.2e-3
    acting_s = written_s + dead_time_s
    ends_s = np.append(acting_s[1:], time_s[-1] + 1.0)
    stair_s = np.concatenate([[-1.0, acting_s[0]], np.column_stack([acting_s, ends_s]).ravel()])
    stair_pa = OFFSET_PA + GAIN * np.concatenate([[LOW_PA, LOW_PA], np.repeat(command_pa, 2)])
    if lag_s > 0.0:
        stair_s, stair_pa = lagged(stair_s, stair_pa, float(stair_pa[0]), lag_s, 1.0e-3)
    # at a step the level after it
    after = np.searchsorted(stair_s, time_s, side="right") - 1
    share = (time_s - stair_s[after]) / np.maximum(
        stair_s[np.minimum(after + 1, stair_s.size - 1)] - stair_s[after], 1e-9
    )
    pressure_pa = stair_pa[after] + share * (stair_pa[np.minimum(after + 1, stair_pa.size - 1)] - stair_pa[after])
    force_n = AREA_M2 * stair_pa
    start_m = float(force_n[0] - NOMINAL.parameters.preload_n) / NOMINAL.parameters.spring_rate_n_per_m
    motion = simulate_motion(NOMINAL.parameters, stair_s, force_n, time_s, initial=StemState(start_m, 0.0))
    recording = Recording(
        time_s,
        motion.position_m + NOISE_M * random.standard_normal(time_s.size),
        pressure_pa=pressure_pa + noise_pa * random.standard_normal(time_s.size),
        command_pa=command_pa,
        sent_s=sent_s,
        received_s=time_s + 0.2e-3,
        provenance=Provenance(acquisition=Acquisition.POLLED, requested_period_s=period_s, timing_uncertainty_s=0.2e-3),
    )
    return PolledTest(recording, stair_s, force_n)


def commanded(recording: Recording) -> CommandedPath:
    path = input_path(recording, NAMEPLATE)
    assert isinstance(path, CommandedPath)
    return path


def force(corners: tuple[FloatArray, FloatArray], wanted_s: FloatArray) -> FloatArray:
    assert (np.diff(corners[0]) >= 0.0).all()
    return np.interp(wanted_s, *corners)


def test_the_stairs_answer_is_that_of_the_lines() -> None:
    step_s, level = np.array([0.0, 0.3, 0.35, 1.0]), np.array([1.0, 3.0, 2.0, -1.0])
    at_s = np.linspace(-0.1, 3.0, 500)
    stair_s = np.array([0.0, 0.3, 0.3, 0.35, 0.35, 1.0, 1.0, 4.0])
    lines = lagged(stair_s, np.repeat(level, 2), 1.0, 0.2, 1.0e-7)
    assert stair_answer(step_s, level, at_s, 0.2) == pytest.approx(np.interp(at_s, *lines), abs=3.0e-7)
    assert stair_answer(step_s, level, np.array([0.29, 0.3, 0.36, 5.0]), 0.0) == pytest.approx([1.0, 3.0, 2.0, -1.0])


@pytest.mark.parametrize("lag_s", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("period_s", [0.02, 0.05])
def test_lag_dead_time_gain_and_offset_are_found(lag_s: float, period_s: float) -> None:
    fit = commanded(polled(lag_s, period_s, dead_time_s=0.03).recording).fit
    assert fit.noise_n == pytest.approx(AREA_M2 * NOISE_PA, rel=0.1)
    assert abs(fit.lag_s + fit.dead_time_s - lag_s - 0.03) < 0.5e-3 + 4.0 * fit.delay_sd_s
    sigma = np.sqrt((fit.root**2).sum(axis=0))
    truth = [AREA_M2 * OFFSET_PA, GAIN]
    assert np.abs((fit.linear[:2] - truth) / sigma[:2]).max() < 4.0
    assert abs(fit.lag_s - lag_s) < 4.0 * np.hypot(sigma[3], fit.delay_sd_s)


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("period_s", [0.02, 0.05])
def test_the_force_is_right_to_its_variations(lag_s: float, period_s: float) -> None:
    """At the middles of the treads, the delay fitted as the position would: squares in units of the variations."""
    squares = []
    for seed in range(2):
        test = polled(lag_s, period_s, seed=seed)
        path = commanded(test.recording)
        wanted_s = test.recording.time_s[20:-20] + 0.5 * period_s
        true_n = force((test.force_time_s, test.force_n), wanted_s)
        delays = np.linspace(-3.0 * path.delay.prior_sd, 3.0 * path.delay.prior_sd, 121)
        off = [float(np.std(force(path.corners(np.array([d])), wanted_s) - true_n)) for d in delays]
        best = np.array([delays[int(np.argmin(off))]])
        plain_n = force(path.corners(best), wanted_s)
        variance = np.full(wanted_s.size, (1.0e-3 * AREA_M2 * NOISE_PA) ** 2)
        for corners in path.variations(best):
            variance += (force(corners, wanted_s) - plain_n) ** 2
        squares.append(float(np.mean((plain_n - true_n) ** 2 / variance)))
        assert float(np.abs(plain_n - true_n).max()) < 0.1 * AREA_M2 * NOISE_PA + 0.02 * float(
            np.median(np.abs(np.diff(path.level_n)))
        )
    assert float(np.mean(squares)) < 4.0


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.3])
def test_the_true_valve_explains_the_position_under_this_force_and_not_under_the_measured_one(lag_s: float) -> None:
    recording = polled(lag_s, 0.05).recording
    start = StemState(float(recording.position_m[:3].mean()), 0.0)

    def misfit(path: InputPath, delay_s: float) -> float:
        at_s, force_n = path.corners(np.array([delay_s]))
        rows = recording.time_s >= at_s[0]
        motion = simulate_motion(NOMINAL.parameters, at_s, force_n, recording.time_s[rows], initial=start)
        return float(np.sqrt(np.mean((recording.position_m[rows] - motion.position_m) ** 2))) / NOISE_M

    path = commanded(recording)
    centre_s, half_s = 0.0, 3.0 * path.delay.prior_sd
    for _ in range(3):
        delays = np.linspace(centre_s - half_s, centre_s + half_s, 31)
        centre_s, half_s = float(min(delays, key=lambda delay: misfit(path, float(delay)))), half_s / 10.0
    assert misfit(path, centre_s) < 1.3
    measured = measured_path(recording, recording.actuator_force_n(NAMEPLATE))
    assert isinstance(measured, MeasuredPath)
    assert min(misfit(measured, float(delay)) for delay in np.linspace(-0.03, 0.03, 61)) > 1.4


def test_a_look_that_is_late_does_not_make_its_write_late() -> None:
    test = polled(0.0, 0.02, late=0.15)
    recording, path = test.recording, commanded(test.recording)
    assert recording.sent_s is not None
    true_s = test.force_time_s[2::2][: path.step_s.size]
    apart_s = path.step_s - true_s
    assert float(np.std(apart_s[5:-5])) < 0.25e-3
    # the requests themselves
    assert float(np.std(recording.sent_s - true_s)) > 1.5e-3


def test_the_lateness_is_that_of_the_ramps_own_time() -> None:
    random = np.random.default_rng(2)
    begun_s = np.arange(500, dtype=np.float64) * 0.02 + random.uniform(0.0, 1.0e-3, 500)
    late_s = np.where(random.random(500) < 0.1, random.uniform(0.0, 0.015, 500), 0.0)
    found_s = lateness_s(begun_s + late_s, 1.0e3 * np.abs(begun_s - 5.0))
    apart_s = found_s - late_s
    assert float(np.abs(np.delete(apart_s, np.arange(245, 256))).max()) < 0.2e-3
    steps = np.repeat([1.0, 5.0, 2.0, 9.0, 4.0], 100)
    assert (lateness_s(begun_s, steps) == 0.0).all()


def test_without_a_lag_the_delay_is_known_to_within_the_write() -> None:
    path = commanded(polled(0.0, 0.02).recording)
    (delay,) = path.nuisances
    assert 0.2e-3 < delay.prior_sd < 3.0e-3
    assert path.fit.lag_s < 1.0e-3


def test_missed_slots_hold_the_command_longer() -> None:
    path = commanded(polled(0.05, 0.02, missed=60).recording)
    assert path.fit.lag_s == pytest.approx(0.05, abs=1.0e-3)
    assert path.breaks_s.shape == (0, 2)


def test_rows_without_values_are_left_out() -> None:
    recording = polled(0.05, 0.02).recording
    assert recording.pressure_pa is not None
    assert recording.command_pa is not None
    holes = np.random.default_rng(3).choice(recording.samples, 20, replace=False)
    pressure_pa, command_pa = recording.pressure_pa.copy(), recording.command_pa.copy()
    pressure_pa[holes] = command_pa[holes] = np.nan
    path = commanded(replace(recording, pressure_pa=pressure_pa, command_pa=command_pa))
    assert path.fit.lag_s == pytest.approx(0.05, abs=3.0e-3)


def test_a_pressure_that_does_not_answer_so_is_taken_as_measured() -> None:
    recording = polled(0.05, 0.02).recording
    assert recording.pressure_pa is not None
    # a supply that is too low, and a second lag
    limited_pa = np.minimum(recording.pressure_pa, LOW_PA + 0.8 * SPAN_PA)
    assert isinstance(input_path(replace(recording, pressure_pa=limited_pa), NAMEPLATE), MeasuredPath)
    steps = [stair_answer(recording.time_s, recording.pressure_pa, recording.time_s, 0.3)]
    twice_pa = steps[0] + NOISE_PA * np.random.default_rng(5).standard_normal(recording.samples)
    slow = replace(recording, pressure_pa=stair_answer(recording.time_s, twice_pa, recording.time_s, 0.3))
    assert isinstance(input_path(slow, NAMEPLATE), MeasuredPath)
    captured = replace(recording, provenance=Provenance(acquisition=Acquisition.CAPTURED))
    assert isinstance(input_path(captured, NAMEPLATE), MeasuredPath)


def test_a_polled_command_without_a_pressure_is_its_staircase() -> None:
    test = polled(0.05, 0.02)
    path: object = input_path(replace(test.recording, pressure_pa=None), NAMEPLATE)
    assert isinstance(path, TransducerPath)
    wanted_s = test.recording.time_s[20:-20]
    expected_n = (force((test.force_time_s, test.force_n), wanted_s) / AREA_M2 - OFFSET_PA) / GAIN * AREA_M2
    got_n = [force(path.corners(np.array([0.05, d])), wanted_s) - expected_n for d in np.linspace(-2e-3, 2e-3, 81)]
    assert min(float(np.abs(off).max()) for off in got_n) < 0.01 * float(np.median(np.abs(np.diff(expected_n))))


def test_a_delay_moves_all_corners() -> None:
    path: InputPath = commanded(polled(0.05, 0.02).recording)
    plain_s, plain_n = path.corners(np.zeros(1))
    later_s, later_n = path.corners(np.array([0.004]))
    assert later_s == pytest.approx(plain_s + 0.004)
    assert (later_n == plain_n).all()
