"""How far a mean position at rest may be off by the sensor's grid, against the mean itself over all offsets."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from estimators.samples import Samples, prepare
from estimators.slips.windows import grid_error
from tests.estimators.recordings import recorded

STEP_M = 10.0e-6


def true_error_m(noise_m: float) -> float:
    """Error, rms over all offsets, of the mean of a reading on the grid with this Gaussian noise."""
    offset = np.linspace(-0.5, 0.5, 201)[:, None]
    edge = np.arange(-60, 60)[None, :] + 0.5
    # the mean of a rounded value is the sum over the edges that it is above, less those below zero
    above = ndtr((offset - edge) * STEP_M / noise_m)
    mean = above[:, 60:].sum(axis=1) - (1.0 - above[:, :60]).sum(axis=1)
    return STEP_M * float(np.sqrt(np.mean((mean - offset[:, 0]) ** 2)))


def samples_with(noise_m: float) -> Samples:
    """Samples on the grid whose noise is this one and the grid's own together."""
    one = recorded("nominal", period_s=0.01, resolution_m=STEP_M)
    samples = prepare(one.recording, one.nameplate)
    assert isinstance(samples, Samples)
    both_m = math.hypot(noise_m, STEP_M / math.sqrt(12.0))
    return replace(samples, position_noise_m=both_m, position_step_m=STEP_M)


@pytest.mark.parametrize("share", [0.2, 0.35, 0.6])
def test_the_error_is_that_of_a_dither_known_to_seven_tenths(share: float) -> None:
    error_m, undithered = grid_error(samples_with(share * STEP_M))
    expected_m = true_error_m(0.7 * share * STEP_M)
    assert expected_m <= error_m <= 1.45 * expected_m
    assert undithered == (share < 0.5)


def test_without_noise_the_error_is_the_grids_own() -> None:
    error_m, undithered = grid_error(samples_with(0.0))
    assert error_m == pytest.approx(STEP_M / math.sqrt(12.0))
    assert undithered
