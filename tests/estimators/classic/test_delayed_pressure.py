"""A delay between the channels that the recording allows for: the intervals hold what it does."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimators.base import Estimate
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.support.published_recordings import Recorded, paper_triangle, recorded
from valve.recording import Acquisition, Provenance

PERIOD_S = 5.0e-3
METHODS: list[type[ClassicEstimator]] = [RegressionEstimator, GarciaEstimator]


def delayed(valve: str, noise_m: float, late_s: float, open_s: float) -> Recorded:
    """The paper's triangle with a pressure that is read this late, and a recording that leaves ``open_s`` open."""
    one = recorded(valve, noise_m=noise_m, period_s=PERIOD_S)
    recording = replace(
        one.recording,
        pressure_pa=paper_triangle(valve).at(one.recording.time_s - late_s),
        provenance=Provenance(Acquisition.POLLED, requested_period_s=PERIOD_S, timing_uncertainty_s=open_s),
    )
    return replace(one, recording=recording)


def half_width(estimate: Estimate, symbol: str) -> float:
    low, high = estimate.parameters[symbol].ci95 or (math.nan, math.nan)
    return 0.5 * (high - low)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("valve", "late_s"), [("rough", 2.0e-3), ("nominal", -2.0e-3)])
def test_spring_frictions_and_preload_say_what_a_delay_does(
    valve: str, late_s: float, method: type[ClassicEstimator]
) -> None:
    one = delayed(valve, 1.0e-6, late_s, abs(late_s))
    estimate = method().estimate(one.recording, one.nameplate)
    for symbol in ("k", "F_c", "F_s", "F_0"):
        value = estimate.value(symbol)
        assert value is not None, symbol
        assert abs(value - one.truth.by_symbol()[symbol]) < 1.5 * half_width(estimate, symbol), symbol


@pytest.mark.parametrize("method", METHODS)
def test_a_delay_that_a_recording_leaves_open_widens_its_frictions(method: type[ClassicEstimator]) -> None:
    short, long = (
        method().estimate(one.recording, one.nameplate)
        for one in (delayed("nominal", 1.0e-6, 0.0, 25.0e-6), delayed("nominal", 1.0e-6, 0.0, 5.0e-3))
    )
    for symbol in ("F_c", "F_s"):
        assert half_width(long, symbol) > 1.2 * half_width(short, symbol), symbol
