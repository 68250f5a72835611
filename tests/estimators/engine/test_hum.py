"""The mains' hum is taken off where the rests show it, and nothing else is."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pytest

from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.hum import without_hum
from tests.support.random_valves import random_test
from tests.support.rough_valves import case

FloatArray = npt.NDArray[np.float64]

NOISE_M: Final = 20.0e-6


def _moved(period_s: float, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """A minute of a stem that is driven, rests and slips, with white and slow noise, and no hum."""
    time_s = np.arange(0.0, 60.0, period_s)
    rng = np.random.default_rng(seed)
    driven_m = 0.02 * np.sin(0.3 * time_s)
    slips_m = 1.0e-3 * np.floor(time_s / 3.0) * (time_s < 30.0)
    noise_m = NOISE_M * rng.normal(size=time_s.size) + np.cumsum(rng.normal(0.0, 5.0e-7, time_s.size))
    return time_s, driven_m + slips_m + noise_m


@pytest.mark.parametrize("hertz", [50.0, 59.96])
@pytest.mark.parametrize("drift_hz_per_s", [0.0, 3.0e-4])
@pytest.mark.parametrize("size_m", [3.0e-6, 14.0e-6])
def test_hum_goes_and_nothing_else(hertz: float, drift_hz_per_s: float, size_m: float) -> None:
    time_s, plain_m = _moved(1.0e-3)
    hum_m = size_m * np.sin(2.0 * math.pi * (hertz + 0.5 * drift_hz_per_s * time_s) * time_s + 0.7)

    left_m = without_hum(time_s, plain_m + hum_m) - plain_m

    for first_s in (0.0, 15.0, 30.0, 45.0):
        inside = (time_s >= first_s) & (time_s < first_s + 15.0)
        assert np.std(left_m[inside]) < 0.35 * np.std(hum_m)


def test_after_a_pause_of_days_the_hum_is_taken_off_by_itself_and_no_grid_spans_them() -> None:
    time_s, plain_m = _moved(1.0e-3)
    hum_m = 14.0e-6 * np.sin(2.0 * math.pi * 50.0 * time_s)
    days_s, twice_m = np.concatenate([time_s, time_s + 30.0 * 86400.0]), np.concatenate([plain_m, plain_m])

    left_m = without_hum(days_s, twice_m + np.concatenate([hum_m, hum_m])) - twice_m

    alone_m = without_hum(time_s, plain_m + hum_m) - plain_m
    assert left_m == pytest.approx(np.concatenate([alone_m, alone_m]), abs=1.0e-9)


def test_noise_alone_is_left_as_it_is() -> None:
    for seed in range(8):
        time_s, position_m = _moved(1.0e-3, seed)
        assert without_hum(time_s, position_m) is position_m


def test_rows_that_are_too_slow_to_show_it_are_left_as_they_are() -> None:
    time_s, plain_m = _moved(20.0e-3)
    position_m = plain_m + 30.0e-6 * np.sin(2.0 * math.pi * 47.0 * time_s)
    assert without_hum(time_s, position_m) is position_m


@pytest.mark.long
def test_a_hum_is_no_stem_that_swings() -> None:
    # 10 um at 50 Hz on a valve whose friction is 45 N: a stem of 0.5 kg without damping swings at 50.8 Hz
    made = case("vendor", "triangle", "hard", seed=6002)
    truth = made.truth.parameters.by_symbol()
    found = RoughFrictionEstimator().estimate(made.recording, made.nameplate).parameters

    assert found["m"].value is None
    coulomb = found["F_c"]
    assert coulomb.value == pytest.approx(truth["F_c"], rel=0.2)
    assert coulomb.ci95 is not None
    assert coulomb.ci95[0] <= truth["F_c"] <= coulomb.ci95[1]


@pytest.mark.parametrize("seed", [2098, 2174, 2184])
def test_the_lines_of_a_stem_that_slips_again_and_again_are_no_hum(seed: int) -> None:
    recording = random_test(seed).recording

    assert without_hum(recording.time_s, recording.position_m) is recording.position_m
