"""The measured force as a polyline: its corners to rounding, or as well as the noise allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Outcome
from estimators.likelihood.inputs.input_path import InputPath, input_path
from estimators.likelihood.inputs.pressure_lines import held_together
from estimators.samples import FloatArray
from valve.nameplate import Actuator, Nameplate
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, dwell, multi_rate_triangle, sine, steps, triangle

AREA_M2 = 0.0645
NAMEPLATE = Nameplate("FV-1", Actuator(travel_m=0.1, diaphragm_area_m2=AREA_M2))
LOW_PA, HIGH_PA = 20.0e3, 100.0e3
SPAN_PA = HIGH_PA - LOW_PA
WAVES = {
    "triangle": triangle(20.0, 3, LOW_PA, HIGH_PA),
    "multi_rate": multi_rate_triangle([20.0, *[2.0] * 20], LOW_PA, HIGH_PA),
    "dwell": dwell(20.0, LOW_PA, HIGH_PA, [1.0, 2.0]),
}


def measured(
    wave: Waveform, period_s: float, noise_pa: float, *, seed: int = 1, jitter: float = 0.0, step_pa: float = 0.0
) -> Recording:
    random = np.random.default_rng(seed)
    time_s = np.arange(round(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    if jitter > 0.0:
        time_s[1:-1] += np.clip(random.normal(0.0, jitter, time_s.size - 2), -0.4, 0.4) * period_s
    pressure_pa = wave.at(time_s) + noise_pa * random.standard_normal(time_s.size)
    if step_pa > 0.0:
        pressure_pa = np.round(pressure_pa / step_pa) * step_pa
    return Recording(time_s, np.zeros(time_s.size), pressure_pa=pressure_pa)


def path_of(recording: Recording) -> InputPath:
    path = input_path(recording, NAMEPLATE)
    assert not isinstance(path, Outcome)
    return path


def start(path: InputPath) -> FloatArray:
    return np.array([nuisance.start for nuisance in path.nuisances])


def pressure(path: InputPath, time_s: FloatArray) -> FloatArray:
    at_s, force_n = path.corners(start(path))
    assert (np.diff(at_s) >= 0.0).all()
    return np.interp(time_s, at_s, force_n) / AREA_M2


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize("period_s", [1.0e-3, 0.01, 0.05])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_computed_pressure_gives_its_corners_to_rounding(name: str, period_s: float, jitter: float) -> None:
    wave = WAVES[name]
    path = path_of(measured(wave, period_s, 0.0, jitter=jitter))
    at_s, force_n = path.corners(start(path))
    assert at_s[1:-1] == pytest.approx(wave.time_s, abs=1.0e-11)
    assert force_n[1:-1] / AREA_M2 == pytest.approx(wave.pressure_pa, abs=1.0e-9 * SPAN_PA)
    assert list(path.variations(start(path))) == []


def test_corners_between_the_samples_are_found_there() -> None:
    wave = multi_rate_triangle([3.0 * np.sqrt(2.0), np.pi, np.e], LOW_PA, HIGH_PA)
    at_s, _ = path_of(measured(wave, 0.05, 0.0)).corners(np.zeros(1))
    assert at_s[2:-2] == pytest.approx(wave.time_s[1:-1], abs=1.0e-10)


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize("period_s", [1.0e-3, 0.01, 0.05])
@pytest.mark.parametrize("noise", [1.0e-4, 1.0e-3, 5.0e-3])
def test_a_noisy_pressure_gets_as_many_lines_as_it_has(name: str, period_s: float, noise: float) -> None:
    wave = WAVES[name]
    path = path_of(measured(wave, period_s, noise * SPAN_PA, jitter=0.2))
    at_s, _ = path.corners(start(path))
    assert at_s.size == wave.time_s.size + 2
    # a corner where two lines of some 100 to 10,000 rows cross
    slope = float(np.abs(np.diff(wave.pressure_pa) / np.diff(wave.time_s)).min())
    rows = min(1.0, np.diff(wave.time_s).min()) / period_s
    expected_s = noise * SPAN_PA / np.sqrt(rows) / max(slope, SPAN_PA / 10.0)
    assert at_s[2:-2] == pytest.approx(wave.time_s[1:-1], abs=10.0 * expected_s)


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize(("period_s", "noise"), [(0.01, 1.0e-3), (0.02, 5.0e-3)])
def test_the_truth_lies_within_the_variations(name: str, period_s: float, noise: float) -> None:
    """Squares of the error of force at some times, in units of what the variations say, average to 1."""
    wave = WAVES[name]
    wanted_s = np.linspace(0.3, wave.duration_s - 0.3, 41)
    squares = []
    for seed in range(30):
        path = path_of(measured(wave, period_s, noise * SPAN_PA, seed=seed))
        plain = pressure(path, wanted_s)
        variance = np.zeros(wanted_s.size)
        for at_s, force_n in path.variations(start(path)):
            variance += (np.interp(wanted_s, at_s, force_n) / AREA_M2 - plain) ** 2
        squares.append((plain - wave.at(wanted_s)) ** 2 / variance)
    assert float(np.mean(squares)) == pytest.approx(1.0, abs=0.25)


def test_a_converter_of_16_bits_costs_no_lines() -> None:
    wave = WAVES["triangle"]
    path = path_of(measured(wave, 1.0e-3, 0.0, step_pa=1.2 * SPAN_PA / 65534.0))
    at_s, force_n = path.corners(start(path))
    assert at_s[1:-1] == pytest.approx(wave.time_s, abs=2.0e-5)
    assert force_n[1:-1] / AREA_M2 == pytest.approx(wave.pressure_pa, abs=2.0e-6 * SPAN_PA)


@pytest.mark.parametrize("noise", [0.0, 1.0e-3])
def test_a_step_is_two_corners_at_one_time_between_the_samples(noise: float) -> None:
    wave = steps([LOW_PA, 0.5 * (LOW_PA + HIGH_PA), HIGH_PA, LOW_PA], 5.0)
    path = path_of(measured(wave, 0.01, noise * SPAN_PA))
    at_s, force_n = path.corners(start(path))
    steps_s = at_s[1:][np.diff(at_s) == 0.0]
    assert steps_s == pytest.approx([5.0, 10.0, 15.0], abs=0.0051)
    levels_pa = np.interp([2.5, 7.5, 12.5, 17.5], at_s, force_n) / AREA_M2
    assert levels_pa == pytest.approx(wave.pressure_pa[::2], abs=0.3 * noise * SPAN_PA + 1.0e-6)


@pytest.mark.parametrize("period_s", [1.0e-3, 0.01])
@pytest.mark.parametrize("noise", [0.0, 1.0e-3])
def test_a_sine_is_followed_far_below_its_noise(period_s: float, noise: float) -> None:
    wave = sine(8.0, 3, LOW_PA, HIGH_PA)
    recording = measured(wave, period_s, noise * SPAN_PA)
    path = path_of(recording)
    off_pa = pressure(path, recording.time_s) - wave.at(recording.time_s)
    # a dozen coefficients a period, and as much again for where the pieces end
    expected_pa = noise * SPAN_PA * np.sqrt(12.0 * period_s / 8.0)
    assert float(np.sqrt(np.mean(off_pa**2))) < 3.0 * expected_pa + 1.0e-6 * SPAN_PA


def test_a_gap_is_bridged_by_the_lines_on_both_sides() -> None:
    wave = WAVES["triangle"]
    recording = measured(wave, 0.01, 1.0e-3 * SPAN_PA)
    pressure_pa = recording.pressure_pa
    assert pressure_pa is not None
    holed_pa = pressure_pa.copy()
    for middle_s in (4.0, 10.05, 27.0):  # within two ramps, and over the first corner
        holed_pa[np.abs(recording.time_s - middle_s) < 0.2] = np.nan
    path = path_of(Recording(recording.time_s, recording.position_m, pressure_pa=holed_pa))
    at_s, _ = path.corners(start(path))
    assert path.breaks_s.size == 0
    assert at_s[1:-1] == pytest.approx(wave.time_s, abs=0.02)


def test_a_long_gap_over_a_corner_is_a_break() -> None:
    recording = measured(WAVES["triangle"], 0.01, 1.0e-3 * SPAN_PA)
    pressure_pa = recording.pressure_pa
    assert pressure_pa is not None
    holed_pa = pressure_pa.copy()
    holed_pa[np.abs(recording.time_s - 20.3) < 1.0] = np.nan
    path = path_of(Recording(recording.time_s, recording.position_m, pressure_pa=holed_pa))
    assert path.breaks_s == pytest.approx(np.array([[19.3, 21.3]]), abs=0.02)


@pytest.mark.parametrize("noise", [0.0, 1.0e-3])
def test_between_two_recordings_put_together_is_a_break(noise: float) -> None:
    one = measured(WAVES["triangle"], 0.01, noise * SPAN_PA)
    two = measured(WAVES["multi_rate"], 0.01, noise * SPAN_PA, seed=2)
    assert one.pressure_pa is not None
    assert two.pressure_pa is not None
    joined = Recording(
        np.concatenate([one.time_s, two.time_s + 60.1]),
        np.concatenate([one.position_m, two.position_m]),
        pressure_pa=np.concatenate([one.pressure_pa, two.pressure_pa]),
    )
    path = path_of(joined)
    assert path.breaks_s == pytest.approx(np.array([[60.0, 60.1]]))
    off_pa = pressure(path, joined.time_s) - np.concatenate(
        [WAVES["triangle"].at(one.time_s), WAVES["multi_rate"].at(two.time_s)]
    )
    assert float(np.abs(off_pa).max()) < noise * SPAN_PA + 1.0e-6


@pytest.mark.parametrize("late_s", [-0.015, 0.015])
def test_a_ramp_goes_on_beyond_the_rows_that_tell_it_as_far_as_a_delay_asks(late_s: float) -> None:
    # a recording of the midst of a triangle: held at its ends, the last rows' force was that of 15 ms before
    wave = WAVES["triangle"]
    whole = measured(wave, 0.01, 0.0)
    assert whole.pressure_pa is not None
    rows = (whole.time_s >= 3.0) & (whole.time_s <= 57.0)
    recording = Recording(whole.time_s[rows], whole.position_m[rows], pressure_pa=whole.pressure_pa[rows])
    at_s, force_n = path_of(recording).corners(np.array([late_s]))
    acting_pa = np.interp(recording.time_s, at_s, force_n) / AREA_M2
    assert acting_pa == pytest.approx(wave.at(recording.time_s - late_s), abs=1.0e-9 * SPAN_PA)


def test_a_few_noisy_rows_between_two_breaks_are_their_line() -> None:
    wave = WAVES["triangle"]
    whole = measured(wave, 0.01, 1.0e-3 * SPAN_PA)
    assert whole.pressure_pa is not None
    rows = ~((np.abs(whole.time_s - 5.0) < 0.2) & (np.abs(whole.time_s - 5.0) > 0.05))
    recording = Recording(whole.time_s[rows], whole.position_m[rows], pressure_pa=whole.pressure_pa[rows])
    path = path_of(recording)
    assert path.breaks_s.shape == (2, 2)
    between_s = np.linspace(4.95, 5.05, 50)
    at_s, force_n = path.corners(np.zeros(1))
    off_pa = np.interp(between_s, at_s, force_n) / AREA_M2 - wave.at(between_s)
    assert float(np.abs(off_pa).max()) < 1.5e-3 * SPAN_PA
    bent_pa = off_pa - np.polyval(np.polyfit(between_s, off_pa, 1), between_s)
    assert float(np.abs(bent_pa).max()) < 1.0e-6 * SPAN_PA


def test_a_line_goes_no_farther_into_a_break_than_its_middle() -> None:
    ramp = (np.array([0.0, 10.0]), np.array([0.0, 100.0])), (np.array([10.4, 20.0]), np.array([50.0, 50.0]))
    breaks_s = np.array([[10.0, 10.4]])
    at_s, force_n = held_together(list(ramp), breaks_s, 0.5)
    assert np.interp([10.1, 10.19], at_s, force_n) == pytest.approx([101.0, 101.9])
    assert np.interp([10.21, 10.4, 20.4], at_s, force_n) == pytest.approx(50.0)
    # held from the lead on, and where it was settled
    at_s, force_n = held_together(list(ramp), breaks_s, 0.05, settled=True)
    assert np.interp([-0.05, 10.05, 10.15], at_s, force_n) == pytest.approx([0.0, 100.5, 100.5])
    # a step at the end is no ramp
    at_s, force_n = held_together([(np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 5.0]))], np.empty((0, 2)), 0.5)
    assert force_n[-1] == 5.0


def test_a_delay_moves_all_corners_and_leaves_the_start_covered() -> None:
    recording = measured(WAVES["triangle"], 1.0e-3, 0.0)
    path = path_of(recording)
    (delay,) = path.nuisances
    plain_s, plain_n = path.corners(np.zeros(1))
    later_s, later_n = path.corners(np.array([delay.upper]))
    assert delay.name == "delay_s"
    assert (delay.lower, delay.upper) == pytest.approx((-0.02, 0.02))
    assert later_s == pytest.approx(plain_s + delay.upper)
    assert (later_n == plain_n).all()
    assert later_s[0] < recording.time_s[0]


def test_the_delay_is_known_as_well_as_the_acquisition_says() -> None:
    recording = measured(WAVES["triangle"], 0.05, 0.0)

    def prior_s(**provenance: object) -> float:
        known = replace(recording, provenance=Provenance(**provenance))  # type: ignore[arg-type]
        return path_of(known).nuisances[0].prior_sd

    assert prior_s(acquisition=Acquisition.CAPTURED) == pytest.approx(0.00025)
    assert prior_s(acquisition=Acquisition.POLLED, timing_uncertainty_s=0.004) == pytest.approx(0.004)
    assert prior_s() == pytest.approx(0.05)


def test_an_input_that_tells_nothing_is_named() -> None:
    time_s = np.arange(1000, dtype=np.float64) * 0.01
    level = np.random.default_rng(1).normal(5.0e4, 10.0, 1000)
    assert input_path(Recording(time_s, time_s, pressure_pa=level), NAMEPLATE) is Outcome.NO_FORCE_CHANGE
    few = Recording(time_s[:5], time_s[:5], pressure_pa=time_s[:5])
    assert input_path(few, NAMEPLATE) is Outcome.TOO_FEW_SAMPLES
    bare = Nameplate("FV-1", Actuator(travel_m=0.1))
    assert input_path(measured(WAVES["triangle"], 0.01, 0.0), bare) is Outcome.NO_DIAPHRAGM_AREA
